/* The functions of FMI 3.0 for model exchange and co-simulation.

   A singular matrix gives fmi3Discard with a message, never a result. With FMI_STANDARD_HEADERS the declarations are
   those of the standard's own headers, without it the equal ones below.
*/

#include <stdbool.h>

#include "fmi-instance.h"

#ifdef FMI_STANDARD_HEADERS
#include "fmi3Functions.h"
#define FMI(name) name
#else
typedef void *fmi3Instance;
typedef void *fmi3InstanceEnvironment;
typedef void *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean;
typedef const char *fmi3String;
typedef uint8_t fmi3Byte;
typedef const fmi3Byte *fmi3Binary;
typedef bool fmi3Clock;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum {
    fmi3Independent,
    fmi3Constant,
    fmi3Fixed,
    fmi3Tunable,
    fmi3Discrete,
    fmi3Dependent
} fmi3DependencyKind;
typedef enum { fmi3IntervalNotYetKnown, fmi3IntervalUnchanged, fmi3IntervalChanged } fmi3IntervalQualifier;
typedef void (*fmi3LogMessageCallback)(
    fmi3InstanceEnvironment, fmi3Status, fmi3String category, fmi3String message);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment);
typedef void (*fmi3IntermediateUpdateCallback)(
    fmi3InstanceEnvironment,
    fmi3Float64,
    fmi3Boolean,
    fmi3Boolean,
    fmi3Boolean,
    fmi3Boolean,
    fmi3Boolean *,
    fmi3Float64 *);
typedef void (*fmi3LockPreemptionCallback)(void);
typedef void (*fmi3UnlockPreemptionCallback)(void);
#ifdef FMI3_FUNCTION_PREFIX
#define JOINED(prefix, name) prefix##name
#define PREFIXED(prefix, name) JOINED(prefix, name)
#define FMI(name) PREFIXED(FMI3_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif
#endif

#define REFERENCES const fmi3ValueReference references[], size_t count

static fmi3Status tell(Instance *model, fmi3Status status, const char *function, const char *message) {
    if (model != NULL && model->logger != NULL) {
        char text[300];
        snprintf(text, sizeof text, "%s: %s", function, message);
        fmi3LogMessageCallback logger = (fmi3LogMessageCallback)model->logger;
        logger(model->environment, status, status == fmi3Discard ? "logStatusDiscard" : "logStatusError", text);
    }
    return status;
}

static fmi3Status status_of(Instance *model, int found, const char *function) {
    const fmi3Status status = found == FINE ? fmi3OK : found == SINGULAR ? fmi3Discard : fmi3Error;
    return found == FINE ? status : tell(model, status, function, message_of(model, found));
}

/* Leave the calling function with an error unless the instance is in one of some phases. */
#define NEEDS(phases, function)                                                              \
    Instance *model = component;                                                             \
    if (model == NULL || !(model->now.phase & (phases))) {                                   \
        return tell(model, fmi3Error, function, "the function cannot be called now");        \
    }

EXPORTED const char *FMI(fmi3GetVersion)(void) {
    return "3.0";
}

EXPORTED fmi3Status FMI(fmi3SetDebugLogging)(
    fmi3Instance component, fmi3Boolean on, size_t count, const fmi3String categories[]) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi3SetDebugLogging")
    (void)count;
    (void)categories;
    model->logging = on;
    return fmi3OK;
}

static fmi3Instance instantiate(
    fmi3String name,
    fmi3String token,
    fmi3Boolean logging,
    fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log_message,
    int stepped) {
    Instance *model = instance_of(name, token, stepped);
    if (model == NULL) {
        if (log_message != NULL) {
            log_message(environment, fmi3Error, "logStatusError", "there is no name, or the token is another");
        }
        return NULL;
    }
    model->logging = logging;
    model->logger = (void (*)(void))log_message;
    model->environment = environment;
    return model;
}

EXPORTED fmi3Instance FMI(fmi3InstantiateModelExchange)(
    fmi3String name,
    fmi3String token,
    fmi3String resources,
    fmi3Boolean visible,
    fmi3Boolean logging,
    fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log_message) {
    (void)resources;
    (void)visible;
    return instantiate(name, token, logging, environment, log_message, 0);
}

EXPORTED fmi3Instance FMI(fmi3InstantiateCoSimulation)(
    fmi3String name,
    fmi3String token,
    fmi3String resources,
    fmi3Boolean visible,
    fmi3Boolean logging,
    fmi3Boolean event_mode,
    fmi3Boolean early_return,
    const fmi3ValueReference required[],
    size_t count,
    fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log_message,
    fmi3IntermediateUpdateCallback update) {
    (void)resources;
    (void)visible;
    (void)early_return;
    (void)required;
    (void)update;
    if (event_mode || count > 0) {
        return NULL;
    }
    return instantiate(name, token, logging, environment, log_message, 1);
}

EXPORTED fmi3Instance FMI(fmi3InstantiateScheduledExecution)(
    fmi3String name,
    fmi3String token,
    fmi3String resources,
    fmi3Boolean visible,
    fmi3Boolean logging,
    fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log_message,
    fmi3ClockUpdateCallback clock,
    fmi3LockPreemptionCallback lock,
    fmi3UnlockPreemptionCallback unlock) {
    (void)name;
    (void)token;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)environment;
    (void)log_message;
    (void)clock;
    (void)lock;
    (void)unlock;
    return NULL;
}

EXPORTED void FMI(fmi3FreeInstance)(fmi3Instance component) {
    release(component);
}

EXPORTED fmi3Status FMI(fmi3EnterInitializationMode)(
    fmi3Instance component,
    fmi3Boolean tolerant,
    fmi3Float64 tolerance,
    fmi3Float64 from,
    fmi3Boolean ends,
    fmi3Float64 end) {
    NEEDS(INSTANTIATED, "fmi3EnterInitializationMode")
    (void)ends;
    (void)end;
    if (tolerant && !(tolerance > 0.0)) {
        return tell(model, fmi3Error, "fmi3EnterInitializationMode", "the tolerance is not positive");
    }
    if (tolerant) {
        model->now.rtol = tolerance;
    }
    set_time(model, from);
    model->now.phase = INITIALIZING;
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3ExitInitializationMode)(fmi3Instance component) {
    NEEDS(INITIALIZING, "fmi3ExitInitializationMode")
    model->now.phase = model->stepped ? STEPPING : EVENTS;
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3Terminate)(fmi3Instance component) {
    NEEDS(EVENTS | CONTINUOUS | STEPPING, "fmi3Terminate")
    model->now.phase = TERMINATED;
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3Reset)(fmi3Instance component) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi3Reset")
    start(model);
    return fmi3OK;
}

/* --- variables: all are real */

EXPORTED fmi3Status FMI(fmi3GetFloat64)(
    fmi3Instance component, REFERENCES, fmi3Float64 values[], size_t size) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi3GetFloat64")
    if (size != count) {
        return tell(model, fmi3Error, "fmi3GetFloat64", "the number of values is another");
    }
    for (size_t i = 0; i < count; i++) {
        const int found = variable(model, references[i], &values[i]);
        if (found != FINE) {
            return status_of(model, found, "fmi3GetFloat64");
        }
    }
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3SetFloat64)(
    fmi3Instance component, REFERENCES, const fmi3Float64 values[], size_t size) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi3SetFloat64")
    if (size != count) {
        return tell(model, fmi3Error, "fmi3SetFloat64", "the number of values is another");
    }
    for (size_t i = 0; i < count; i++) {
        const int found = set_variable(model, references[i], values[i]);
        if (found != FINE) {
            return status_of(model, found, "fmi3SetFloat64");
        }
    }
    return fmi3OK;
}

static fmi3Status none(Instance *model, size_t count, const char *function) {
    return count == 0 ? fmi3OK : status_of(model, NO_VARIABLE, function);
}

#define NO_VARIABLES(Kind)                                                                            \
    EXPORTED fmi3Status FMI(fmi3Get##Kind)(                                                           \
        fmi3Instance component, REFERENCES, fmi3##Kind values[], size_t size) {                       \
        (void)references;                                                                             \
        (void)values;                                                                                 \
        (void)size;                                                                                   \
        return none(component, count, "fmi3Get" #Kind);                                               \
    }                                                                                                 \
    EXPORTED fmi3Status FMI(fmi3Set##Kind)(                                                           \
        fmi3Instance component, REFERENCES, const fmi3##Kind values[], size_t size) {                 \
        (void)references;                                                                             \
        (void)values;                                                                                 \
        (void)size;                                                                                   \
        return none(component, count, "fmi3Set" #Kind);                                               \
    }

NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(Int32)
NO_VARIABLES(UInt32)
NO_VARIABLES(Int64)
NO_VARIABLES(UInt64)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

EXPORTED fmi3Status FMI(fmi3GetBinary)(
    fmi3Instance component, REFERENCES, size_t sizes[], fmi3Binary values[], size_t size) {
    (void)references;
    (void)sizes;
    (void)values;
    (void)size;
    return none(component, count, "fmi3GetBinary");
}

EXPORTED fmi3Status FMI(fmi3SetBinary)(
    fmi3Instance component, REFERENCES, const size_t sizes[], const fmi3Binary values[], size_t size) {
    (void)references;
    (void)sizes;
    (void)values;
    (void)size;
    return none(component, count, "fmi3SetBinary");
}

EXPORTED fmi3Status FMI(fmi3GetClock)(fmi3Instance component, REFERENCES, fmi3Clock values[]) {
    (void)references;
    (void)values;
    return none(component, count, "fmi3GetClock");
}

EXPORTED fmi3Status FMI(fmi3SetClock)(fmi3Instance component, REFERENCES, const fmi3Clock values[]) {
    (void)references;
    (void)values;
    return none(component, count, "fmi3SetClock");
}

/* --- there are no clocks */

EXPORTED fmi3Status FMI(fmi3GetIntervalDecimal)(
    fmi3Instance component, REFERENCES, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[]) {
    (void)references;
    (void)intervals;
    (void)qualifiers;
    return none(component, count, "fmi3GetIntervalDecimal");
}

EXPORTED fmi3Status FMI(fmi3GetIntervalFraction)(
    fmi3Instance component,
    REFERENCES,
    fmi3UInt64 counters[],
    fmi3UInt64 resolutions[],
    fmi3IntervalQualifier qualifiers[]) {
    (void)references;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return none(component, count, "fmi3GetIntervalFraction");
}

EXPORTED fmi3Status FMI(fmi3GetShiftDecimal)(fmi3Instance component, REFERENCES, fmi3Float64 shifts[]) {
    (void)references;
    (void)shifts;
    return none(component, count, "fmi3GetShiftDecimal");
}

EXPORTED fmi3Status FMI(fmi3GetShiftFraction)(
    fmi3Instance component, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[]) {
    (void)references;
    (void)counters;
    (void)resolutions;
    return none(component, count, "fmi3GetShiftFraction");
}

EXPORTED fmi3Status FMI(fmi3SetIntervalDecimal)(
    fmi3Instance component, REFERENCES, const fmi3Float64 intervals[]) {
    (void)references;
    (void)intervals;
    return none(component, count, "fmi3SetIntervalDecimal");
}

EXPORTED fmi3Status FMI(fmi3SetIntervalFraction)(
    fmi3Instance component, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]) {
    (void)references;
    (void)counters;
    (void)resolutions;
    return none(component, count, "fmi3SetIntervalFraction");
}

EXPORTED fmi3Status FMI(fmi3SetShiftDecimal)(fmi3Instance component, REFERENCES, const fmi3Float64 shifts[]) {
    (void)references;
    (void)shifts;
    return none(component, count, "fmi3SetShiftDecimal");
}

EXPORTED fmi3Status FMI(fmi3SetShiftFraction)(
    fmi3Instance component, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]) {
    (void)references;
    (void)counters;
    (void)resolutions;
    return none(component, count, "fmi3SetShiftFraction");
}

/* --- derivatives */

EXPORTED fmi3Status FMI(fmi3GetDirectionalDerivative)(
    fmi3Instance component,
    const fmi3ValueReference unknowns[],
    size_t unknown_count,
    REFERENCES,
    const fmi3Float64 seed[],
    size_t seeds,
    fmi3Float64 sensitivity[],
    size_t sensitivities) {
    NEEDS(EVALUATING, "fmi3GetDirectionalDerivative")
    if (seeds != count || sensitivities != unknown_count) {
        return tell(model, fmi3Error, "fmi3GetDirectionalDerivative", "the number of values is another");
    }
    const int found = derivatives_of(model, unknowns, unknown_count, references, count, seed, sensitivity);
    return status_of(model, found, "fmi3GetDirectionalDerivative");
}

EXPORTED fmi3Status FMI(fmi3GetAdjointDerivative)(
    fmi3Instance component,
    const fmi3ValueReference unknowns[],
    size_t unknown_count,
    REFERENCES,
    const fmi3Float64 seed[],
    size_t seeds,
    fmi3Float64 sensitivity[],
    size_t sensitivities) {
    NEEDS(EVALUATING, "fmi3GetAdjointDerivative")
    if (seeds != unknown_count || sensitivities != count) {
        return tell(model, fmi3Error, "fmi3GetAdjointDerivative", "the number of values is another");
    }
    for (size_t i = 0; i < count; i++) {
        double direction[Model_STATES] = {0.0};
        if (!is_state(references[i])) {
            return tell(model, fmi3Error, "fmi3GetAdjointDerivative", "derivatives are those by the state");
        }
        direction[references[i] - FIRST_STATE] = 1.0;
        sensitivity[i] = 0.0;
        for (size_t j = 0; j < unknown_count; j++) {
            double value = 0.0;
            const int found = derivative_of(model, unknowns[j], direction, &value);
            if (found != FINE) {
                return status_of(model, found, "fmi3GetAdjointDerivative");
            }
            sensitivity[i] += value * seed[j];
        }
    }
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3GetNumberOfVariableDependencies)(
    fmi3Instance component, fmi3ValueReference reference, size_t *count) {
    (void)reference;
    (void)count;
    return tell(component, fmi3Error, "fmi3GetNumberOfVariableDependencies", "dependencies do not change");
}

EXPORTED fmi3Status FMI(fmi3GetVariableDependencies)(
    fmi3Instance component,
    fmi3ValueReference dependent,
    size_t elements[],
    fmi3ValueReference independents[],
    size_t independent_elements[],
    fmi3DependencyKind kinds[],
    size_t count) {
    (void)dependent;
    (void)elements;
    (void)independents;
    (void)independent_elements;
    (void)kinds;
    (void)count;
    return tell(component, fmi3Error, "fmi3GetVariableDependencies", "dependencies do not change");
}

EXPORTED fmi3Status FMI(fmi3EnterConfigurationMode)(fmi3Instance component) {
    return tell(component, fmi3Error, "fmi3EnterConfigurationMode", "there are no structural parameters");
}

EXPORTED fmi3Status FMI(fmi3ExitConfigurationMode)(fmi3Instance component) {
    return tell(component, fmi3Error, "fmi3ExitConfigurationMode", "there are no structural parameters");
}

/* --- the state as a whole */

EXPORTED fmi3Status FMI(fmi3GetFMUState)(fmi3Instance component, fmi3FMUState *state) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi3GetFMUState")
    return status_of(model, keep(state, &model->now), "fmi3GetFMUState");
}

EXPORTED fmi3Status FMI(fmi3SetFMUState)(fmi3Instance component, fmi3FMUState state) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi3SetFMUState")
    if (state == NULL) {
        return tell(model, fmi3Error, "fmi3SetFMUState", "there is no state");
    }
    restore(model, state);
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3FreeFMUState)(fmi3Instance component, fmi3FMUState *state) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi3FreeFMUState")
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3SerializedFMUStateSize)(fmi3Instance component, fmi3FMUState state, size_t *size) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi3SerializedFMUStateSize")
    (void)state;
    *size = sizeof(Numbers);
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3SerializeFMUState)(
    fmi3Instance component, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi3SerializeFMUState")
    if (state == NULL || size < sizeof(Numbers)) {
        return tell(model, fmi3Error, "fmi3SerializeFMUState", "there is no state, or the bytes are too few");
    }
    memcpy(bytes, state, sizeof(Numbers));
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3DeserializeFMUState)(
    fmi3Instance component, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi3DeserializeFMUState")
    if (size != sizeof(Numbers)) {
        return tell(model, fmi3Error, "fmi3DeserializeFMUState", "the bytes are not those of a state");
    }
    return status_of(model, keep(state, bytes), "fmi3DeserializeFMUState");
}

/* --- model exchange */

EXPORTED fmi3Status FMI(fmi3EnterEventMode)(fmi3Instance component) {
    NEEDS(EVENTS | CONTINUOUS, "fmi3EnterEventMode")
    model->now.phase = EVENTS;
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3EvaluateDiscreteStates)(fmi3Instance component) {
    NEEDS(INITIALIZING | EVENTS, "fmi3EvaluateDiscreteStates")
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3UpdateDiscreteStates)(
    fmi3Instance component,
    fmi3Boolean *again,
    fmi3Boolean *terminate,
    fmi3Boolean *nominals_changed,
    fmi3Boolean *values_changed,
    fmi3Boolean *next_event,
    fmi3Float64 *next_event_time) {
    NEEDS(EVENTS, "fmi3UpdateDiscreteStates")
    *again = *terminate = *nominals_changed = *values_changed = *next_event = false;
    *next_event_time = 0.0;
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3EnterContinuousTimeMode)(fmi3Instance component) {
    NEEDS(EVENTS, "fmi3EnterContinuousTimeMode")
    model->now.phase = CONTINUOUS;
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3CompletedIntegratorStep)(
    fmi3Instance component, fmi3Boolean final, fmi3Boolean *enter_event_mode, fmi3Boolean *terminate) {
    NEEDS(CONTINUOUS, "fmi3CompletedIntegratorStep")
    (void)final;
    *enter_event_mode = false;
    *terminate = false;
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3SetTime)(fmi3Instance component, fmi3Float64 time) {
    NEEDS(EVENTS | CONTINUOUS, "fmi3SetTime")
    set_time(model, time);
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3SetContinuousStates)(fmi3Instance component, const fmi3Float64 state[], size_t count) {
    NEEDS(EVENTS | CONTINUOUS, "fmi3SetContinuousStates")
    if (count != Model_STATES) {
        return tell(model, fmi3Error, "fmi3SetContinuousStates", "the number of states is another");
    }
    set_state(model, state);
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3GetContinuousStateDerivatives)(
    fmi3Instance component, fmi3Float64 derivatives[], size_t count) {
    NEEDS(EVALUATING, "fmi3GetContinuousStateDerivatives")
    if (count != Model_STATES) {
        return tell(model, fmi3Error, "fmi3GetContinuousStateDerivatives", "the number of states is another");
    }
    const int found = evaluate(model, 0);
    if (found == FINE) {
        memcpy(derivatives, model->results, sizeof model->now.y);
    }
    return status_of(model, found, "fmi3GetContinuousStateDerivatives");
}

EXPORTED fmi3Status FMI(fmi3GetEventIndicators)(fmi3Instance component, fmi3Float64 indicators[], size_t count) {
    NEEDS(EVALUATING, "fmi3GetEventIndicators")
    if (count != Model_INDICATORS) {
        return tell(model, fmi3Error, "fmi3GetEventIndicators", "the number of event indicators is another");
    }
    for (size_t i = 0; i < count; i++) {
        const int found = variable(model, Model_FIRST_INDICATOR + (uint32_t)i, &indicators[i]);
        if (found != FINE) {
            return status_of(model, found, "fmi3GetEventIndicators");
        }
    }
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3GetContinuousStates)(fmi3Instance component, fmi3Float64 state[], size_t count) {
    NEEDS(EVALUATING, "fmi3GetContinuousStates")
    if (count != Model_STATES) {
        return tell(model, fmi3Error, "fmi3GetContinuousStates", "the number of states is another");
    }
    memcpy(state, model->now.y, sizeof model->now.y);
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3GetNominalsOfContinuousStates)(
    fmi3Instance component, fmi3Float64 nominals[], size_t count) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi3GetNominalsOfContinuousStates")
    for (size_t i = 0; i < count; i++) {
        nominals[i] = 1.0;
    }
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3GetNumberOfEventIndicators)(fmi3Instance component, size_t *count) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi3GetNumberOfEventIndicators")
    *count = Model_INDICATORS;
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3GetNumberOfContinuousStates)(fmi3Instance component, size_t *count) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi3GetNumberOfContinuousStates")
    *count = Model_STATES;
    return fmi3OK;
}

/* --- co-simulation */

EXPORTED fmi3Status FMI(fmi3EnterStepMode)(fmi3Instance component) {
    return tell(component, fmi3Error, "fmi3EnterStepMode", "co-simulation has no event mode");
}

EXPORTED fmi3Status FMI(fmi3GetOutputDerivatives)(
    fmi3Instance component, REFERENCES, const fmi3Int32 orders[], fmi3Float64 values[], size_t size) {
    (void)references;
    (void)orders;
    (void)values;
    (void)size;
    return none(component, count, "fmi3GetOutputDerivatives");
}

EXPORTED fmi3Status FMI(fmi3DoStep)(
    fmi3Instance component,
    fmi3Float64 point,
    fmi3Float64 step,
    fmi3Boolean final,
    fmi3Boolean *event_handling,
    fmi3Boolean *terminate,
    fmi3Boolean *early_return,
    fmi3Float64 *last_time) {
    NEEDS(STEPPING, "fmi3DoStep")
    (void)final;
    *event_handling = *terminate = *early_return = false;
    *last_time = model->now.t;
    if (!(step > 0.0) || !(fabs(point - model->now.t) <= 1e-9 * (1.0 + fabs(point)))) {
        return tell(model, fmi3Error, "fmi3DoStep", "the step does not begin where the last one ended, or goes back");
    }
    const int outcome = run(model, point + step);
    *last_time = model->now.t;
    if (outcome != 0) {
        return tell(model, fmi3Discard, "fmi3DoStep", model_outcome(outcome));
    }
    return fmi3OK;
}

EXPORTED fmi3Status FMI(fmi3ActivateModelPartition)(
    fmi3Instance component, fmi3ValueReference clock, fmi3Float64 time) {
    (void)clock;
    (void)time;
    return tell(component, fmi3Error, "fmi3ActivateModelPartition", "there are no clocks");
}
