/* An instance of the model for all versions of FMI: its state, access to its variables, and runs with error control.

   Reference numbers of variables: 0 is the time. The state, the parameters, and the results of each quantity in the
   order of model_quantities follow. The derivatives of the state are the first results.
*/

#ifndef Instance_H
#define Instance_H

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi-model.h"

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif

enum { FIRST_STATE = 1, FIRST_PARAMETER = FIRST_STATE + Model_STATES };
enum { FIRST_INPUT = FIRST_PARAMETER + Model_FIRST_INPUT };
enum { FIRST_RESULT = FIRST_PARAMETER + Model_PARAMETERS };

/* Phases of an instance. The allowed calls depend on the phase. The values are bits, so that several can be joined. */
enum { INSTANTIATED = 1, INITIALIZING = 2, EVENTS = 4, CONTINUOUS = 8, STEPPING = 16, TERMINATED = 32 };
enum { EVALUATING = INITIALIZING | EVENTS | CONTINUOUS | STEPPING | TERMINATED };

enum { FINE, SINGULAR, NO_VARIABLE, NOT_SET_NOW, NO_STATE, NO_MEMORY };

/* The state of an FMU, which an environment can save and restore. */
typedef struct {
    double t;
    double y[Model_STATES];
    double parameters[Model_PARAMETERS + 1];
    double rtol;
    int phase;
} Numbers;

typedef struct {
    Numbers now;
    int stepped; /* 1 for co-simulation, 0 for model exchange */
    int prepared, singular;
    double p[Model_PREPARED];
    int known[Model_QUANTITIES];
    double results[Model_RESULTS];
    int logging;
    char *name;
    void *environment;
    void (*logger)(void);
} Instance;

static void changed(Instance *model) {
    memset(model->known, 0, sizeof model->known);
}

static void start(Instance *model) {
    memset(&model->now, 0, sizeof model->now);
    memcpy(model->now.y, model_initial, sizeof model->now.y);
    for (int i = 0; i < Model_PARAMETERS; i++) {
        model->now.parameters[i] = Model_DEFAULTS[i];
    }
    model->now.rtol = Model_RTOL;
    model->now.phase = INSTANTIATED;
    model->prepared = 0;
    changed(model);
}

static Instance *instance_of(const char *name, const char *token, int stepped) {
    if (name == NULL || name[0] == '\0' || token == NULL || strcmp(token, Model_TOKEN) != 0) {
        return NULL;
    }
    Instance *model = calloc(1, sizeof *model);
    char *copy = malloc(strlen(name) + 1);
    if (model == NULL || copy == NULL) {
        free(model);
        free(copy);
        return NULL;
    }
    strcpy(copy, name);
    model->name = copy;
    model->stepped = stepped;
    start(model);
    return model;
}

static void release(Instance *model) {
    if (model != NULL) {
        free(model->name);
        free(model);
    }
}

static int prepare(Instance *model) {
    if (!model->prepared) {
        model->singular = Model_PREPARE(model->now.parameters, model->p);
        model->prepared = 1;
    }
    return model->singular ? SINGULAR : FINE;
}

/* Return the message for a result other than FINE. */
static const char *message_of(const Instance *model, int found) {
    switch (found) {
    case SINGULAR:
        return model->singular ? "a matrix is singular to round-off with these parameters"
                               : "a matrix is singular to round-off at this state";
    case NO_VARIABLE:
        return "there is no such variable";
    case NO_STATE:
        return "derivatives are those by the state";
    case NO_MEMORY:
        return "there is no memory";
    default:
        return "this variable cannot be set now";
    }
}

/* Compute a quantity, unless its results are known for the present time, state and parameters. */
static int evaluate(Instance *model, int quantity) {
    const Quantity *one = &model_quantities[quantity];
    if (prepare(model) != FINE) {
        return SINGULAR;
    }
    if (!model->known[quantity]) {
        if (one->function(model->now.t, model->now.y, model->p, model->results + one->first)) {
            return SINGULAR;
        }
        model->known[quantity] = 1;
    }
    return FINE;
}

static int variable(Instance *model, uint32_t reference, double *value) {
    if (reference >= FIRST_RESULT + Model_RESULTS) {
        return NO_VARIABLE;
    }
    const int place = (int)reference;
    if (place < FIRST_STATE) {
        *value = model->now.t;
    } else if (place < FIRST_PARAMETER) {
        *value = model->now.y[place - FIRST_STATE];
    } else if (place < FIRST_RESULT) {
        *value = model->now.parameters[place - FIRST_PARAMETER];
    } else {
        int quantity = Model_QUANTITIES - 1;
        while (model_quantities[quantity].first > place - FIRST_RESULT) {
            quantity--;
        }
        if (evaluate(model, quantity) != FINE) {
            return SINGULAR;
        }
        *value = model->results[place - FIRST_RESULT];
    }
    return FINE;
}

/* Inputs may be changed at any time, parameters between steps, the state before the simulation. */
static int set_variable(Instance *model, uint32_t reference, double value) {
    if (reference >= FIRST_RESULT + Model_RESULTS) {
        return NO_VARIABLE;
    }
    const int place = (int)reference;
    if (FIRST_STATE <= place && place < FIRST_PARAMETER && (model->now.phase & (INSTANTIATED | INITIALIZING))) {
        model->now.y[place - FIRST_STATE] = value;
    } else if (FIRST_INPUT <= place && place < FIRST_RESULT && !(model->now.phase & TERMINATED)) {
        model->now.parameters[place - FIRST_PARAMETER] = value;
        model->p[place - FIRST_PARAMETER] = value;
    } else if (FIRST_PARAMETER <= place && place < FIRST_RESULT && !(model->now.phase & (CONTINUOUS | TERMINATED))) {
        model->now.parameters[place - FIRST_PARAMETER] = value;
        model->prepared = 0;
    } else {
        return NOT_SET_NOW;
    }
    changed(model);
    return FINE;
}

static void set_time(Instance *model, double t) {
    model->now.t = t;
    changed(model);
}

static void set_state(Instance *model, const double *y) {
    memcpy(model->now.y, y, sizeof model->now.y);
    changed(model);
}

/* Run to the time `end` with error control. Return the outcome of the integrator: 0 is success, 3 a singular matrix. */
static int run(Instance *model, double end) {
    if (prepare(model) != FINE) {
        return 3;
    }
    changed(model);
    int64_t outcome = 0;
    if (end > model->now.t) {
        outcome = Model_RUN(&model->now.t, end, model->now.y, model->p, model->now.rtol, model->now.rtol, 10000000);
    }
    return (int)outcome;
}

/* Compute the directional derivative of an unknown, an entry of the state or of its time derivative. */
static int derivative_of(Instance *model, uint32_t unknown, const double *direction, double *value) {
    const int place = (int)(unknown < FIRST_RESULT + Model_RESULTS ? unknown : 0);
    if (FIRST_STATE <= place && place < FIRST_PARAMETER) {
        *value = direction[place - FIRST_STATE];
        return FINE;
    }
#ifdef Model_JACOBIAN
    if (place < FIRST_RESULT || place >= FIRST_RESULT + Model_STATES) {
        return NO_VARIABLE;
    }
    if (evaluate(model, Model_JACOBIAN) != FINE) {
        return SINGULAR;
    }
    const double *row = model->results + model_quantities[Model_JACOBIAN].first + (place - FIRST_RESULT) * Model_STATES;
    *value = 0.0;
    for (int i = 0; i < Model_STATES; i++) {
        *value += row[i] * direction[i];
    }
    return FINE;
#else
    (void)model;
    return NO_VARIABLE;
#endif
}

static int is_state(uint32_t reference) {
    return reference >= FIRST_STATE && reference < FIRST_PARAMETER;
}

/* Compute the directional derivatives of unknowns. The seed has the direction for some entries of the state. */
static int derivatives_of(
    Instance *model,
    const uint32_t *unknowns,
    size_t unknown_count,
    const uint32_t *references,
    size_t count,
    const double *seed,
    double *sensitivity) {
    double direction[Model_STATES] = {0.0};
    for (size_t i = 0; i < count; i++) {
        if (!is_state(references[i])) {
            return NO_STATE;
        }
        direction[references[i] - FIRST_STATE] = seed[i];
    }
    for (size_t i = 0; i < unknown_count; i++) {
        const int found = derivative_of(model, unknowns[i], direction, &sensitivity[i]);
        if (found != FINE) {
            return found;
        }
    }
    return FINE;
}

/* Copy the numbers of a state to *state. Memory is allocated if *state is NULL. */
static int keep(void **state, const void *numbers) {
    if (*state == NULL) {
        *state = malloc(sizeof(Numbers));
    }
    if (*state == NULL) {
        return NO_MEMORY;
    }
    memcpy(*state, numbers, sizeof(Numbers));
    return FINE;
}

static void restore(Instance *model, const void *state) {
    memcpy(&model->now, state, sizeof(Numbers));
    model->prepared = 0;
    changed(model);
}

#endif
