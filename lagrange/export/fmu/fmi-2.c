/* The functions of FMI 2.0 for model exchange and co-simulation.

   A singular matrix gives fmi2Discard with a message, never a result. With FMI_STANDARD_HEADERS the declarations are
   those of the standard's own headers, without it the equal ones below.
*/

#include "fmi-instance.h"

#ifdef FMI_STANDARD_HEADERS
#include "fmi2Functions.h"
#define FMI(name) name
#else
typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef void (*fmi2CallbackLogger)(
    fmi2ComponentEnvironment, fmi2String name, fmi2Status, fmi2String category, fmi2String message, ...);
typedef void *(*fmi2CallbackAllocateMemory)(size_t, size_t);
typedef void (*fmi2CallbackFreeMemory)(void *);
typedef void (*fmi2StepFinished)(fmi2ComponentEnvironment, fmi2Status);
typedef struct {
    fmi2CallbackLogger logger;
    fmi2CallbackAllocateMemory allocateMemory;
    fmi2CallbackFreeMemory freeMemory;
    fmi2StepFinished stepFinished;
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;
typedef struct {
    fmi2Boolean newDiscreteStatesNeeded;
    fmi2Boolean terminateSimulation;
    fmi2Boolean nominalsOfContinuousStatesChanged;
    fmi2Boolean valuesOfContinuousStatesChanged;
    fmi2Boolean nextEventTimeDefined;
    fmi2Real nextEventTime;
} fmi2EventInfo;
#ifdef FMI2_FUNCTION_PREFIX
#define JOINED(prefix, name) prefix##name
#define PREFIXED(prefix, name) JOINED(prefix, name)
#define FMI(name) PREFIXED(FMI2_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif
#endif

#define REFERENCES const fmi2ValueReference references[], size_t count

static fmi2Status tell(Instance *model, fmi2Status status, const char *function, const char *message) {
    if (model != NULL && model->logger != NULL) {
        char text[300];
        snprintf(text, sizeof text, "%s: %s", function, message);
        fmi2CallbackLogger logger = (fmi2CallbackLogger)model->logger;
        const char *category = status == fmi2Discard ? "logStatusDiscard" : "logStatusError";
        logger(model->environment, model->name, status, category, text);
    }
    return status;
}

static fmi2Status status_of(Instance *model, int found, const char *function) {
    const fmi2Status status = found == FINE ? fmi2OK : found == SINGULAR ? fmi2Discard : fmi2Error;
    return found == FINE ? status : tell(model, status, function, message_of(model, found));
}

/* Leave the calling function with an error unless the instance is in one of some phases. */
#define NEEDS(phases, function)                                                              \
    Instance *model = component;                                                             \
    if (model == NULL || !(model->now.phase & (phases))) {                                   \
        return tell(model, fmi2Error, function, "the function cannot be called now");        \
    }

EXPORTED const char *FMI(fmi2GetTypesPlatform)(void) {
    return "default";
}

EXPORTED const char *FMI(fmi2GetVersion)(void) {
    return "2.0";
}

EXPORTED fmi2Status FMI(fmi2SetDebugLogging)(
    fmi2Component component, fmi2Boolean on, size_t count, const fmi2String categories[]) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi2SetDebugLogging")
    (void)count;
    (void)categories;
    model->logging = on;
    return fmi2OK;
}

EXPORTED fmi2Component FMI(fmi2Instantiate)(
    fmi2String name,
    fmi2Type type,
    fmi2String token,
    fmi2String resources,
    const fmi2CallbackFunctions *functions,
    fmi2Boolean visible,
    fmi2Boolean logging) {
    (void)resources;
    (void)visible;
    Instance *model = instance_of(name, token, type == fmi2CoSimulation);
    if (model == NULL) {
        if (functions != NULL && functions->logger != NULL) {
            const char *message = "the name is empty, or the GUID is another";
            functions->logger(functions->componentEnvironment, name, fmi2Error, "logStatusError", message);
        }
        return NULL;
    }
    model->logging = logging;
    if (functions != NULL) {
        model->logger = (void (*)(void))functions->logger;
        model->environment = functions->componentEnvironment;
    }
    return model;
}

EXPORTED void FMI(fmi2FreeInstance)(fmi2Component component) {
    release(component);
}

EXPORTED fmi2Status FMI(fmi2SetupExperiment)(
    fmi2Component component, fmi2Boolean tolerant, fmi2Real tolerance, fmi2Real from, fmi2Boolean ends, fmi2Real end) {
    NEEDS(INSTANTIATED, "fmi2SetupExperiment")
    (void)ends;
    (void)end;
    if (tolerant && !(tolerance > 0.0)) {
        return tell(model, fmi2Error, "fmi2SetupExperiment", "the tolerance is not positive");
    }
    if (tolerant) {
        model->now.rtol = tolerance;
    }
    set_time(model, from);
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2EnterInitializationMode)(fmi2Component component) {
    NEEDS(INSTANTIATED, "fmi2EnterInitializationMode")
    model->now.phase = INITIALIZING;
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2ExitInitializationMode)(fmi2Component component) {
    NEEDS(INITIALIZING, "fmi2ExitInitializationMode")
    model->now.phase = model->stepped ? STEPPING : EVENTS;
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2Terminate)(fmi2Component component) {
    NEEDS(EVENTS | CONTINUOUS | STEPPING, "fmi2Terminate")
    model->now.phase = TERMINATED;
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2Reset)(fmi2Component component) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi2Reset")
    start(model);
    return fmi2OK;
}

/* --- variables: all are real */

EXPORTED fmi2Status FMI(fmi2GetReal)(fmi2Component component, REFERENCES, fmi2Real values[]) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi2GetReal")
    for (size_t i = 0; i < count; i++) {
        const int found = variable(model, references[i], &values[i]);
        if (found != FINE) {
            return status_of(model, found, "fmi2GetReal");
        }
    }
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2SetReal)(fmi2Component component, REFERENCES, const fmi2Real values[]) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi2SetReal")
    for (size_t i = 0; i < count; i++) {
        const int found = set_variable(model, references[i], values[i]);
        if (found != FINE) {
            return status_of(model, found, "fmi2SetReal");
        }
    }
    return fmi2OK;
}

static fmi2Status none(Instance *model, size_t count, const char *function) {
    return count == 0 ? fmi2OK : status_of(model, NO_VARIABLE, function);
}

#define NO_VARIABLES(Kind, kind)                                                                   \
    EXPORTED fmi2Status FMI(fmi2Get##Kind)(fmi2Component component, REFERENCES, kind values[]) {   \
        (void)references;                                                                          \
        (void)values;                                                                              \
        return none(component, count, "fmi2Get" #Kind);                                            \
    }                                                                                              \
    EXPORTED fmi2Status FMI(fmi2Set##Kind)(fmi2Component component, REFERENCES, const kind values[]) { \
        (void)references;                                                                          \
        (void)values;                                                                              \
        return none(component, count, "fmi2Set" #Kind);                                            \
    }

NO_VARIABLES(Integer, fmi2Integer)
NO_VARIABLES(Boolean, fmi2Boolean)
NO_VARIABLES(String, fmi2String)

EXPORTED fmi2Status FMI(fmi2GetDirectionalDerivative)(
    fmi2Component component,
    const fmi2ValueReference unknowns[],
    size_t unknown_count,
    const fmi2ValueReference references[],
    size_t count,
    const fmi2Real seed[],
    fmi2Real sensitivity[]) {
    NEEDS(EVALUATING, "fmi2GetDirectionalDerivative")
    const int found = derivatives_of(model, unknowns, unknown_count, references, count, seed, sensitivity);
    return status_of(model, found, "fmi2GetDirectionalDerivative");
}

/* --- the state as a whole */

EXPORTED fmi2Status FMI(fmi2GetFMUstate)(fmi2Component component, fmi2FMUstate *state) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi2GetFMUstate")
    return status_of(model, keep(state, &model->now), "fmi2GetFMUstate");
}

EXPORTED fmi2Status FMI(fmi2SetFMUstate)(fmi2Component component, fmi2FMUstate state) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi2SetFMUstate")
    if (state == NULL) {
        return tell(model, fmi2Error, "fmi2SetFMUstate", "there is no state");
    }
    restore(model, state);
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2FreeFMUstate)(fmi2Component component, fmi2FMUstate *state) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi2FreeFMUstate")
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2SerializedFMUstateSize)(fmi2Component component, fmi2FMUstate state, size_t *size) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi2SerializedFMUstateSize")
    (void)state;
    *size = sizeof(Numbers);
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2SerializeFMUstate)(
    fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi2SerializeFMUstate")
    if (state == NULL || size < sizeof(Numbers)) {
        return tell(model, fmi2Error, "fmi2SerializeFMUstate", "there is no state, or the bytes are too few");
    }
    memcpy(bytes, state, sizeof(Numbers));
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2DeSerializeFMUstate)(
    fmi2Component component, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi2DeSerializeFMUstate")
    if (size != sizeof(Numbers)) {
        return tell(model, fmi2Error, "fmi2DeSerializeFMUstate", "the bytes are not those of a state");
    }
    return status_of(model, keep(state, bytes), "fmi2DeSerializeFMUstate");
}

/* --- model exchange */

EXPORTED fmi2Status FMI(fmi2EnterEventMode)(fmi2Component component) {
    NEEDS(EVENTS | CONTINUOUS, "fmi2EnterEventMode")
    model->now.phase = EVENTS;
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2NewDiscreteStates)(fmi2Component component, fmi2EventInfo *info) {
    NEEDS(EVENTS, "fmi2NewDiscreteStates")
    memset(info, 0, sizeof *info);
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2EnterContinuousTimeMode)(fmi2Component component) {
    NEEDS(EVENTS, "fmi2EnterContinuousTimeMode")
    model->now.phase = CONTINUOUS;
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2CompletedIntegratorStep)(
    fmi2Component component, fmi2Boolean final, fmi2Boolean *enter_event_mode, fmi2Boolean *terminate) {
    NEEDS(CONTINUOUS, "fmi2CompletedIntegratorStep")
    (void)final;
    *enter_event_mode = 0;
    *terminate = 0;
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2SetTime)(fmi2Component component, fmi2Real time) {
    NEEDS(EVENTS | CONTINUOUS, "fmi2SetTime")
    set_time(model, time);
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2SetContinuousStates)(fmi2Component component, const fmi2Real state[], size_t count) {
    NEEDS(EVENTS | CONTINUOUS, "fmi2SetContinuousStates")
    if (count != Model_STATES) {
        return tell(model, fmi2Error, "fmi2SetContinuousStates", "the number of states is another");
    }
    set_state(model, state);
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2GetDerivatives)(fmi2Component component, fmi2Real derivatives[], size_t count) {
    NEEDS(EVALUATING, "fmi2GetDerivatives")
    if (count != Model_STATES) {
        return tell(model, fmi2Error, "fmi2GetDerivatives", "the number of states is another");
    }
    const int found = evaluate(model, 0);
    if (found == FINE) {
        memcpy(derivatives, model->results, sizeof model->now.y);
    }
    return status_of(model, found, "fmi2GetDerivatives");
}

EXPORTED fmi2Status FMI(fmi2GetEventIndicators)(fmi2Component component, fmi2Real indicators[], size_t count) {
    NEEDS(EVALUATING, "fmi2GetEventIndicators")
    if (count != Model_INDICATORS) {
        return tell(model, fmi2Error, "fmi2GetEventIndicators", "the number of event indicators is another");
    }
    for (size_t i = 0; i < count; i++) {
        const int found = variable(model, Model_FIRST_INDICATOR + (uint32_t)i, &indicators[i]);
        if (found != FINE) {
            return status_of(model, found, "fmi2GetEventIndicators");
        }
    }
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2GetContinuousStates)(fmi2Component component, fmi2Real state[], size_t count) {
    NEEDS(EVALUATING, "fmi2GetContinuousStates")
    if (count != Model_STATES) {
        return tell(model, fmi2Error, "fmi2GetContinuousStates", "the number of states is another");
    }
    memcpy(state, model->now.y, sizeof model->now.y);
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2GetNominalsOfContinuousStates)(fmi2Component component, fmi2Real nominals[], size_t count) {
    NEEDS(INSTANTIATED | EVALUATING, "fmi2GetNominalsOfContinuousStates")
    for (size_t i = 0; i < count; i++) {
        nominals[i] = 1.0;
    }
    return fmi2OK;
}

/* --- co-simulation */

EXPORTED fmi2Status FMI(fmi2SetRealInputDerivatives)(
    fmi2Component component, REFERENCES, const fmi2Integer orders[], const fmi2Real values[]) {
    (void)references;
    (void)orders;
    (void)values;
    return none(component, count, "fmi2SetRealInputDerivatives");
}

EXPORTED fmi2Status FMI(fmi2GetRealOutputDerivatives)(
    fmi2Component component, REFERENCES, const fmi2Integer orders[], fmi2Real values[]) {
    (void)references;
    (void)orders;
    (void)values;
    return none(component, count, "fmi2GetRealOutputDerivatives");
}

EXPORTED fmi2Status FMI(fmi2DoStep)(fmi2Component component, fmi2Real point, fmi2Real step, fmi2Boolean final) {
    NEEDS(STEPPING, "fmi2DoStep")
    (void)final;
    if (!(step > 0.0) || !(fabs(point - model->now.t) <= 1e-9 * (1.0 + fabs(point)))) {
        return tell(model, fmi2Error, "fmi2DoStep", "the step does not begin where the last one ended, or goes back");
    }
    const int outcome = run(model, point + step);
    if (outcome != 0) {
        return tell(model, fmi2Discard, "fmi2DoStep", model_outcome(outcome));
    }
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2CancelStep)(fmi2Component component) {
    return tell(component, fmi2Error, "fmi2CancelStep", "steps are not asynchronous");
}

EXPORTED fmi2Status FMI(fmi2GetStatus)(fmi2Component component, const fmi2StatusKind kind, fmi2Status *value) {
    (void)kind;
    (void)value;
    return tell(component, fmi2Discard, "fmi2GetStatus", "steps are not asynchronous");
}

EXPORTED fmi2Status FMI(fmi2GetRealStatus)(fmi2Component component, const fmi2StatusKind kind, fmi2Real *value) {
    NEEDS(STEPPING | TERMINATED, "fmi2GetRealStatus")
    if (kind != fmi2LastSuccessfulTime) {
        return tell(model, fmi2Discard, "fmi2GetRealStatus", "there is no such status");
    }
    *value = model->now.t;
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2GetIntegerStatus)(fmi2Component component, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind;
    (void)value;
    return tell(component, fmi2Discard, "fmi2GetIntegerStatus", "there is no such status");
}

EXPORTED fmi2Status FMI(fmi2GetBooleanStatus)(fmi2Component component, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (component == NULL || kind != fmi2Terminated) {
        return tell(component, fmi2Discard, "fmi2GetBooleanStatus", "there is no such status");
    }
    *value = 0;
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2GetStringStatus)(fmi2Component component, const fmi2StatusKind kind, fmi2String *value) {
    (void)kind;
    (void)value;
    return tell(component, fmi2Discard, "fmi2GetStringStatus", "there is no such status");
}
