/* The functions of FMI 2.0 and of FMI 3.0, for model exchange and co-simulation; fmi-model.h says which version.

   A singular matrix gives the status "discard" with a message, never a result. With FMI_STANDARD_HEADERS the
   declarations are those of the standard's own headers, without it the equal ones below.
*/

#include <stdbool.h>

#include "fmi-instance.h"

#if FMI_VERSION == 2
#define NAMED(name) fmi2##name
#define FUNCTION_PREFIX FMI2_FUNCTION_PREFIX
#else
#define NAMED(name) fmi3##name
#define FUNCTION_PREFIX FMI3_FUNCTION_PREFIX
#endif

#define JOINED(prefix, name) prefix##name
#define PREFIXED(prefix, name) JOINED(prefix, name)
#if defined(FMI_STANDARD_HEADERS) || (FMI_VERSION == 2 && !defined(FMI2_FUNCTION_PREFIX)) || \
    (FMI_VERSION == 3 && !defined(FMI3_FUNCTION_PREFIX))
#define FMI(name) NAMED(name)
#else
#define FMI(name) PREFIXED(FUNCTION_PREFIX, NAMED(name))
#endif

#if FMI_VERSION == 2 && defined(FMI_STANDARD_HEADERS)
#include "fmi2Functions.h"
#elif FMI_VERSION == 2
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
#elif defined(FMI_STANDARD_HEADERS)
#include "fmi3Functions.h"
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
#endif

#if FMI_VERSION == 2
typedef fmi2Component Component;
typedef fmi2FMUstate State;
typedef fmi2Real Real;
#define STATE(before, after) FMI(before##FMUstate##after)
#define SIZE(name)
#else
typedef fmi3Instance Component;
typedef fmi3FMUState State;
typedef fmi3Float64 Real;
#define STATE(before, after) FMI(before##FMUState##after)
#define SIZE(name) , size_t name
#endif
typedef NAMED(Status) Status;
typedef NAMED(Boolean) Boolean;
typedef NAMED(String) String;
typedef NAMED(ValueReference) Reference;
typedef NAMED(Byte) Byte;
#define OK NAMED(OK)
#define DISCARD NAMED(Discard)
#define ERROR NAMED(Error)

#define REFERENCES const Reference references[], size_t count

static Status tell(Instance *model, Status status, const char *function, const char *message) {
    if (model != NULL && model->logger != NULL) {
        char text[300];
        snprintf(text, sizeof text, "%s: %s", function, message);
        const char *category = status == DISCARD ? "logStatusDiscard" : "logStatusError";
#if FMI_VERSION == 2
        ((fmi2CallbackLogger)model->logger)(model->environment, model->name, status, category, text);
#else
        ((fmi3LogMessageCallback)model->logger)(model->environment, status, category, text);
#endif
    }
    return status;
}

static Status status_of(Instance *model, int found, const char *function) {
    const Status status = found == FINE ? OK : found == SINGULAR ? DISCARD : ERROR;
    return found == FINE ? status : tell(model, status, function, message_of(model, found));
}

static Status none(Instance *model, size_t count, const char *function) {
    return count == 0 ? OK : status_of(model, NO_VARIABLE, function);
}

/* Leave the calling function with an error, or with the status of a function of the model. */
#define FAIL(message) return tell(model, ERROR, __func__, message)
#define GIVE(found) return status_of(model, found, __func__)
#define REFUSE(status, message) return tell(component, status, __func__, message)
/* Leave the calling function with an error unless the instance is in one of some phases. */
#define NEEDS(phases)                                                \
    Instance *model = component;                                     \
    if (model == NULL || !(model->now.phase & (phases))) {           \
        FAIL("the function cannot be called now");                   \
    }

EXPORTED const char *FMI(GetVersion)(void) {
    return FMI_VERSION == 2 ? "2.0" : "3.0";
}

EXPORTED Status FMI(SetDebugLogging)(Component component, Boolean on, size_t count, const String categories[]) {
    NEEDS(INSTANTIATED | EVALUATING)
    (void)count, (void)categories;
    model->logging = on;
    return OK;
}

EXPORTED void FMI(FreeInstance)(Component component) {
    release(component);
}

EXPORTED Status FMI(ExitInitializationMode)(Component component) {
    NEEDS(INITIALIZING)
    model->now.phase = model->stepped ? STEPPING : EVENTS;
    return OK;
}

EXPORTED Status FMI(Terminate)(Component component) {
    NEEDS(EVENTS | CONTINUOUS | STEPPING)
    model->now.phase = TERMINATED;
    return OK;
}

EXPORTED Status FMI(Reset)(Component component) {
    NEEDS(INSTANTIATED | EVALUATING)
    start(model);
    return OK;
}

static int begin(Instance *model, int tolerant, double tolerance, double from) {
    if (tolerant && !(tolerance > 0.0)) {
        return 0;
    }
    if (tolerant) {
        model->now.rtol = tolerance;
    }
    set_time(model, from);
    return 1;
}

/* --- variables: all are real */

static int get_all(Instance *model, REFERENCES, double values[]) {
    int found = FINE;
    for (size_t i = 0; i < count && found == FINE; i++) {
        found = variable(model, references[i], &values[i]);
    }
    return found;
}

static int set_all(Instance *model, REFERENCES, const double values[]) {
    int found = FINE;
    for (size_t i = 0; i < count && found == FINE; i++) {
        found = set_variable(model, references[i], values[i]);
    }
    return found;
}

#define NO_VARIABLES(Kind)                                                                                  \
    EXPORTED Status FMI(Get##Kind)(Component component, REFERENCES, NAMED(Kind) values[] SIZE(size)) {      \
        (void)references, (void)values IGNORED_SIZE;                                                        \
        return none(component, count, __func__);                                                            \
    }                                                                                                       \
    EXPORTED Status FMI(Set##Kind)(Component component, REFERENCES, const NAMED(Kind) values[] SIZE(size)) { \
        (void)references, (void)values IGNORED_SIZE;                                                        \
        return none(component, count, __func__);                                                            \
    }

EXPORTED Status FMI(GetDirectionalDerivative)(
    Component component,
    const Reference unknowns[],
    size_t unknown_count,
    REFERENCES,
    const Real seed[] SIZE(seeds),
    Real sensitivity[] SIZE(sensitivities)) {
    NEEDS(EVALUATING)
#if FMI_VERSION == 3
    if (seeds != count || sensitivities != unknown_count) {
        FAIL("the number of values is another");
    }
#endif
    GIVE(derivatives_of(model, unknowns, unknown_count, references, count, seed, sensitivity));
}

/* --- the state as a whole */

EXPORTED Status STATE(Get, )(Component component, State *state) {
    NEEDS(INSTANTIATED | EVALUATING)
    GIVE(keep(state, &model->now));
}

EXPORTED Status STATE(Set, )(Component component, State state) {
    NEEDS(INSTANTIATED | EVALUATING)
    if (state == NULL) {
        FAIL("there is no state");
    }
    restore(model, state);
    return OK;
}

EXPORTED Status STATE(Free, )(Component component, State *state) {
    NEEDS(INSTANTIATED | EVALUATING)
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
    return OK;
}

EXPORTED Status STATE(Serialized, Size)(Component component, State state, size_t *size) {
    NEEDS(INSTANTIATED | EVALUATING)
    (void)state;
    *size = sizeof(Numbers);
    return OK;
}

EXPORTED Status STATE(Serialize, )(Component component, State state, Byte bytes[], size_t size) {
    NEEDS(INSTANTIATED | EVALUATING)
    if (state == NULL || size < sizeof(Numbers)) {
        FAIL("there is no state, or the bytes are too few");
    }
    memcpy(bytes, state, sizeof(Numbers));
    return OK;
}

#if FMI_VERSION == 2
EXPORTED Status STATE(DeSerialize, )(Component component, const Byte bytes[], size_t size, State *state) {
#else
EXPORTED Status STATE(Deserialize, )(Component component, const Byte bytes[], size_t size, State *state) {
#endif
    NEEDS(INSTANTIATED | EVALUATING)
    if (size != sizeof(Numbers)) {
        FAIL("the bytes are not those of a state");
    }
    GIVE(keep(state, bytes));
}

/* --- model exchange */

EXPORTED Status FMI(EnterEventMode)(Component component) {
    NEEDS(EVENTS | CONTINUOUS)
    model->now.phase = EVENTS;
    return OK;
}

EXPORTED Status FMI(EnterContinuousTimeMode)(Component component) {
    NEEDS(EVENTS)
    model->now.phase = CONTINUOUS;
    return OK;
}

EXPORTED Status FMI(CompletedIntegratorStep)(
    Component component, Boolean final, Boolean *enter_event_mode, Boolean *terminate) {
    NEEDS(CONTINUOUS)
    (void)final;
    *enter_event_mode = 0;
    *terminate = 0;
    return OK;
}

EXPORTED Status FMI(SetTime)(Component component, Real time) {
    NEEDS(EVENTS | CONTINUOUS)
    set_time(model, time);
    return OK;
}

EXPORTED Status FMI(SetContinuousStates)(Component component, const Real state[], size_t count) {
    NEEDS(EVENTS | CONTINUOUS)
    if (count != Model_STATES) {
        FAIL("the number of states is another");
    }
    set_state(model, state);
    return OK;
}

EXPORTED Status FMI(GetContinuousStates)(Component component, Real state[], size_t count) {
    NEEDS(EVALUATING)
    if (count != Model_STATES) {
        FAIL("the number of states is another");
    }
    memcpy(state, model->now.y, sizeof model->now.y);
    return OK;
}

#if FMI_VERSION == 2
EXPORTED Status FMI(GetDerivatives)(Component component, Real derivatives[], size_t count) {
#else
EXPORTED Status FMI(GetContinuousStateDerivatives)(Component component, Real derivatives[], size_t count) {
#endif
    NEEDS(EVALUATING)
    if (count != Model_STATES) {
        FAIL("the number of states is another");
    }
    const int found = evaluate(model, 0);
    if (found == FINE) {
        memcpy(derivatives, model->results, sizeof model->now.y);
    }
    GIVE(found);
}

EXPORTED Status FMI(GetEventIndicators)(Component component, Real indicators[], size_t count) {
    NEEDS(EVALUATING)
    if (count != Model_INDICATORS) {
        FAIL("the number of event indicators is another");
    }
    int found = FINE;
    for (size_t i = 0; i < count && found == FINE; i++) {
        found = variable(model, Model_FIRST_INDICATOR + (uint32_t)i, &indicators[i]);
    }
    GIVE(found);
}

EXPORTED Status FMI(GetNominalsOfContinuousStates)(Component component, Real nominals[], size_t count) {
    NEEDS(INSTANTIATED | EVALUATING)
    for (size_t i = 0; i < count; i++) {
        nominals[i] = 1.0;
    }
    return OK;
}

/* --- co-simulation */

static int begins_well(const Instance *model, double point, double step) {
    return step > 0.0 && fabs(point - model->now.t) <= 1e-9 * (1.0 + fabs(point));
}

#define NO_STEP "the step does not begin where the last one ended, or goes back"

#if FMI_VERSION == 2

/* --- what FMI 2.0 alone has */

#define IGNORED_SIZE
NO_VARIABLES(Integer)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

EXPORTED const char *FMI(GetTypesPlatform)(void) {
    return "default";
}

EXPORTED Component FMI(Instantiate)(
    String name,
    fmi2Type type,
    String token,
    String resources,
    const fmi2CallbackFunctions *functions,
    Boolean visible,
    Boolean logging) {
    (void)resources, (void)visible;
    Instance *model = instance_of(name, token, type == fmi2CoSimulation);
    if (model == NULL) {
        if (functions != NULL && functions->logger != NULL) {
            const char *message = "the name is empty, or the GUID is another";
            functions->logger(functions->componentEnvironment, name, ERROR, "logStatusError", message);
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

EXPORTED Status FMI(SetupExperiment)(
    Component component, Boolean tolerant, Real tolerance, Real from, Boolean ends, Real end) {
    NEEDS(INSTANTIATED)
    (void)ends, (void)end;
    if (!begin(model, tolerant, tolerance, from)) {
        FAIL("the tolerance is not positive");
    }
    return OK;
}

EXPORTED Status FMI(EnterInitializationMode)(Component component) {
    NEEDS(INSTANTIATED)
    model->now.phase = INITIALIZING;
    return OK;
}

EXPORTED Status FMI(GetReal)(Component component, REFERENCES, Real values[]) {
    NEEDS(INSTANTIATED | EVALUATING)
    GIVE(get_all(model, references, count, values));
}

EXPORTED Status FMI(SetReal)(Component component, REFERENCES, const Real values[]) {
    NEEDS(INSTANTIATED | EVALUATING)
    GIVE(set_all(model, references, count, values));
}

EXPORTED Status FMI(NewDiscreteStates)(Component component, fmi2EventInfo *info) {
    NEEDS(EVENTS)
    memset(info, 0, sizeof *info);
    return OK;
}

EXPORTED Status FMI(SetRealInputDerivatives)(
    Component component, REFERENCES, const fmi2Integer orders[], const Real values[]) {
    (void)references, (void)orders, (void)values;
    return none(component, count, __func__);
}

EXPORTED Status FMI(GetRealOutputDerivatives)(
    Component component, REFERENCES, const fmi2Integer orders[], Real values[]) {
    (void)references, (void)orders, (void)values;
    return none(component, count, __func__);
}

EXPORTED Status FMI(DoStep)(Component component, Real point, Real step, Boolean final) {
    NEEDS(STEPPING)
    (void)final;
    if (!begins_well(model, point, step)) {
        FAIL(NO_STEP);
    }
    const int outcome = run(model, point + step);
    if (outcome != 0) {
        return tell(model, DISCARD, __func__, model_outcome(outcome));
    }
    return OK;
}

EXPORTED Status FMI(CancelStep)(Component component) {
    REFUSE(ERROR, "steps are not asynchronous");
}

EXPORTED Status FMI(GetStatus)(Component component, const fmi2StatusKind kind, Status *value) {
    (void)kind, (void)value;
    REFUSE(DISCARD, "steps are not asynchronous");
}

EXPORTED Status FMI(GetRealStatus)(Component component, const fmi2StatusKind kind, Real *value) {
    NEEDS(STEPPING | TERMINATED)
    if (kind != fmi2LastSuccessfulTime) {
        return tell(model, DISCARD, __func__, "there is no such status");
    }
    *value = model->now.t;
    return OK;
}

EXPORTED Status FMI(GetIntegerStatus)(Component component, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind, (void)value;
    REFUSE(DISCARD, "there is no such status");
}

EXPORTED Status FMI(GetBooleanStatus)(Component component, const fmi2StatusKind kind, Boolean *value) {
    if (component == NULL || kind != fmi2Terminated) {
        REFUSE(DISCARD, "there is no such status");
    }
    *value = 0;
    return OK;
}

EXPORTED Status FMI(GetStringStatus)(Component component, const fmi2StatusKind kind, String *value) {
    (void)kind, (void)value;
    REFUSE(DISCARD, "there is no such status");
}

#else

/* --- what FMI 3.0 alone has: there are no clocks, and no structural parameters */

#define IGNORED_SIZE , (void)size
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

static Component instantiate(
    String name,
    String token,
    Boolean logging,
    fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log_message,
    int stepped) {
    Instance *model = instance_of(name, token, stepped);
    if (model == NULL) {
        if (log_message != NULL) {
            log_message(environment, ERROR, "logStatusError", "there is no name, or the token is another");
        }
        return NULL;
    }
    model->logging = logging;
    model->logger = (void (*)(void))log_message;
    model->environment = environment;
    return model;
}

EXPORTED Component FMI(InstantiateModelExchange)(
    String name,
    String token,
    String resources,
    Boolean visible,
    Boolean logging,
    fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log_message) {
    (void)resources, (void)visible;
    return instantiate(name, token, logging, environment, log_message, 0);
}

EXPORTED Component FMI(InstantiateCoSimulation)(
    String name,
    String token,
    String resources,
    Boolean visible,
    Boolean logging,
    Boolean event_mode,
    Boolean early_return,
    const Reference required[],
    size_t count,
    fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log_message,
    fmi3IntermediateUpdateCallback update) {
    (void)resources, (void)visible, (void)early_return, (void)required, (void)update;
    if (event_mode || count > 0) {
        return NULL;
    }
    return instantiate(name, token, logging, environment, log_message, 1);
}

EXPORTED Component FMI(InstantiateScheduledExecution)(
    String name,
    String token,
    String resources,
    Boolean visible,
    Boolean logging,
    fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log_message,
    fmi3ClockUpdateCallback clock,
    fmi3LockPreemptionCallback lock,
    fmi3UnlockPreemptionCallback unlock) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log_message, (void)clock, (void)lock, (void)unlock;
    return NULL;
}

EXPORTED Status FMI(EnterInitializationMode)(
    Component component,
    Boolean tolerant,
    Real tolerance,
    Real from,
    Boolean ends,
    Real end) {
    NEEDS(INSTANTIATED)
    (void)ends, (void)end;
    if (!begin(model, tolerant, tolerance, from)) {
        FAIL("the tolerance is not positive");
    }
    model->now.phase = INITIALIZING;
    return OK;
}

EXPORTED Status FMI(GetFloat64)(
    Component component, REFERENCES, Real values[], size_t size) {
    NEEDS(INSTANTIATED | EVALUATING)
    if (size != count) {
        FAIL("the number of values is another");
    }
    GIVE(get_all(model, references, count, values));
}

EXPORTED Status FMI(SetFloat64)(
    Component component, REFERENCES, const Real values[], size_t size) {
    NEEDS(INSTANTIATED | EVALUATING)
    if (size != count) {
        FAIL("the number of values is another");
    }
    GIVE(set_all(model, references, count, values));
}

EXPORTED Status FMI(GetBinary)(
    Component component, REFERENCES, size_t sizes[], fmi3Binary values[], size_t size) {
    (void)references, (void)sizes, (void)values, (void)size;
    return none(component, count, __func__);
}

EXPORTED Status FMI(SetBinary)(
    Component component, REFERENCES, const size_t sizes[], const fmi3Binary values[], size_t size) {
    (void)references, (void)sizes, (void)values, (void)size;
    return none(component, count, __func__);
}

EXPORTED Status FMI(GetClock)(Component component, REFERENCES, fmi3Clock values[]) {
    (void)references, (void)values;
    return none(component, count, __func__);
}

EXPORTED Status FMI(SetClock)(Component component, REFERENCES, const fmi3Clock values[]) {
    (void)references, (void)values;
    return none(component, count, __func__);
}

EXPORTED Status FMI(GetIntervalDecimal)(
    Component component, REFERENCES, Real intervals[], fmi3IntervalQualifier qualifiers[]) {
    (void)references, (void)intervals, (void)qualifiers;
    return none(component, count, __func__);
}

EXPORTED Status FMI(GetIntervalFraction)(
    Component component,
    REFERENCES,
    fmi3UInt64 counters[],
    fmi3UInt64 resolutions[],
    fmi3IntervalQualifier qualifiers[]) {
    (void)references, (void)counters, (void)resolutions, (void)qualifiers;
    return none(component, count, __func__);
}

EXPORTED Status FMI(GetShiftDecimal)(Component component, REFERENCES, Real shifts[]) {
    (void)references, (void)shifts;
    return none(component, count, __func__);
}

EXPORTED Status FMI(GetShiftFraction)(
    Component component, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[]) {
    (void)references, (void)counters, (void)resolutions;
    return none(component, count, __func__);
}

EXPORTED Status FMI(SetIntervalDecimal)(
    Component component, REFERENCES, const Real intervals[]) {
    (void)references, (void)intervals;
    return none(component, count, __func__);
}

EXPORTED Status FMI(SetIntervalFraction)(
    Component component, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]) {
    (void)references, (void)counters, (void)resolutions;
    return none(component, count, __func__);
}

EXPORTED Status FMI(SetShiftDecimal)(Component component, REFERENCES, const Real shifts[]) {
    (void)references, (void)shifts;
    return none(component, count, __func__);
}

EXPORTED Status FMI(SetShiftFraction)(
    Component component, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]) {
    (void)references, (void)counters, (void)resolutions;
    return none(component, count, __func__);
}

EXPORTED Status FMI(GetAdjointDerivative)(
    Component component,
    const Reference unknowns[],
    size_t unknown_count,
    REFERENCES,
    const Real seed[],
    size_t seeds,
    Real sensitivity[],
    size_t sensitivities) {
    NEEDS(EVALUATING)
    if (seeds != unknown_count || sensitivities != count) {
        FAIL("the number of values is another");
    }
    for (size_t i = 0; i < count; i++) {
        double direction[Model_STATES] = {0.0};
        if (!is_state(references[i])) {
            FAIL("derivatives are those by the state");
        }
        direction[references[i] - FIRST_STATE] = 1.0;
        sensitivity[i] = 0.0;
        for (size_t j = 0; j < unknown_count; j++) {
            double value = 0.0;
            const int found = derivative_of(model, unknowns[j], direction, &value);
            if (found != FINE) {
                GIVE(found);
            }
            sensitivity[i] += value * seed[j];
        }
    }
    return OK;
}

EXPORTED Status FMI(GetNumberOfVariableDependencies)(
    Component component, Reference reference, size_t *count) {
    (void)reference, (void)count;
    REFUSE(ERROR, "dependencies do not change");
}

EXPORTED Status FMI(GetVariableDependencies)(
    Component component,
    Reference dependent,
    size_t elements[],
    Reference independents[],
    size_t independent_elements[],
    fmi3DependencyKind kinds[],
    size_t count) {
    (void)dependent, (void)elements, (void)independents, (void)independent_elements, (void)kinds, (void)count;
    REFUSE(ERROR, "dependencies do not change");
}

EXPORTED Status FMI(EnterConfigurationMode)(Component component) {
    REFUSE(ERROR, "there are no structural parameters");
}

EXPORTED Status FMI(ExitConfigurationMode)(Component component) {
    REFUSE(ERROR, "there are no structural parameters");
}

EXPORTED Status FMI(EvaluateDiscreteStates)(Component component) {
    NEEDS(INITIALIZING | EVENTS)
    return OK;
}

EXPORTED Status FMI(UpdateDiscreteStates)(
    Component component,
    Boolean *again,
    Boolean *terminate,
    Boolean *nominals_changed,
    Boolean *values_changed,
    Boolean *next_event,
    Real *next_event_time) {
    NEEDS(EVENTS)
    *again = *terminate = *nominals_changed = *values_changed = *next_event = false;
    *next_event_time = 0.0;
    return OK;
}

EXPORTED Status FMI(GetNumberOfEventIndicators)(Component component, size_t *count) {
    NEEDS(INSTANTIATED | EVALUATING)
    *count = Model_INDICATORS;
    return OK;
}

EXPORTED Status FMI(GetNumberOfContinuousStates)(Component component, size_t *count) {
    NEEDS(INSTANTIATED | EVALUATING)
    *count = Model_STATES;
    return OK;
}

EXPORTED Status FMI(EnterStepMode)(Component component) {
    REFUSE(ERROR, "co-simulation has no event mode");
}

EXPORTED Status FMI(GetOutputDerivatives)(
    Component component, REFERENCES, const fmi3Int32 orders[], Real values[], size_t size) {
    (void)references, (void)orders, (void)values, (void)size;
    return none(component, count, __func__);
}

EXPORTED Status FMI(DoStep)(
    Component component,
    Real point,
    Real step,
    Boolean final,
    Boolean *event_handling,
    Boolean *terminate,
    Boolean *early_return,
    Real *last_time) {
    NEEDS(STEPPING)
    (void)final;
    *event_handling = *terminate = *early_return = false;
    *last_time = model->now.t;
    if (!begins_well(model, point, step)) {
        FAIL(NO_STEP);
    }
    const int outcome = run(model, point + step);
    *last_time = model->now.t;
    if (outcome != 0) {
        return tell(model, DISCARD, __func__, model_outcome(outcome));
    }
    return OK;
}

EXPORTED Status FMI(ActivateModelPartition)(
    Component component, Reference clock, Real time) {
    (void)clock, (void)time;
    REFUSE(ERROR, "there are no clocks");
}

#endif
