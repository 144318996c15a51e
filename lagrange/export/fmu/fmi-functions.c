/* The functions of FMI 2.0 and of FMI 3.0, for model exchange and co-simulation. fmi-model.h defines the version.

   For a singular matrix a function returns the status "discard" with a message, and no result. With
   FMI_STANDARD_HEADERS the declarations come from the headers of the standard, otherwise from the copies below.
*/

#include <stdbool.h>

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard states the parameters */
#endif

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

/* Return an error from the calling function, or the status for a result of the functions in fmi-instance.h. */
#define FAIL(message) return tell(model, ERROR, __func__, message)
#define GIVE(found) return status_of(model, found, __func__)
#define REFUSED(Name, status, message, ...)                  \
    EXPORTED Status FMI(Name)(__VA_ARGS__) {                 \
        return tell(component, status, __func__, message);  \
    }
/* Return an error from the calling function unless the instance is in one of the given phases. */
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

#define NONE(Name, ...)                                                       \
    EXPORTED Status FMI(Name)(Component component, REFERENCES, __VA_ARGS__) { \
        return none(component, count, __func__);                              \
    }
#define NO_VARIABLES(Kind)                          \
    NONE(Get##Kind, NAMED(Kind) values[] SIZE(size)) \
    NONE(Set##Kind, const NAMED(Kind) values[] SIZE(size))

EXPORTED Status FMI(GetDirectionalDerivative)(
    Component component, const Reference unknowns[], size_t unknown_count, REFERENCES,
    const Real seed[] SIZE(seeds), Real sensitivity[] SIZE(sensitivities)) {
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

/* --- functions of FMI 2.0 only */

NO_VARIABLES(Integer)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

EXPORTED const char *FMI(GetTypesPlatform)(void) {
    return "default";
}

EXPORTED Component FMI(Instantiate)(
    String name, fmi2Type type, String token, String resources, const fmi2CallbackFunctions *functions,
    Boolean visible, Boolean logging) {
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

NONE(SetRealInputDerivatives, const fmi2Integer orders[], const Real values[])
NONE(GetRealOutputDerivatives, const fmi2Integer orders[], Real values[])

EXPORTED Status FMI(DoStep)(Component component, Real point, Real step, Boolean final) {
    NEEDS(STEPPING)
    if (!begins_well(model, point, step)) {
        FAIL(NO_STEP);
    }
    const int outcome = run(model, point + step);
    if (outcome != 0) {
        return tell(model, DISCARD, __func__, model_outcome(outcome));
    }
    return OK;
}

REFUSED(CancelStep, ERROR, "steps are not asynchronous", Component component)
REFUSED(GetStatus, DISCARD, "steps are not asynchronous", Component component, const fmi2StatusKind kind,
    Status *value)

EXPORTED Status FMI(GetRealStatus)(Component component, const fmi2StatusKind kind, Real *value) {
    NEEDS(STEPPING | TERMINATED)
    if (kind != fmi2LastSuccessfulTime) {
        return tell(model, DISCARD, __func__, "there is no such status");
    }
    *value = model->now.t;
    return OK;
}

REFUSED(GetIntegerStatus, DISCARD, "there is no such status", Component component, const fmi2StatusKind kind,
    fmi2Integer *value)

EXPORTED Status FMI(GetBooleanStatus)(Component component, const fmi2StatusKind kind, Boolean *value) {
    if (component == NULL || kind != fmi2Terminated) {
        return tell(component, DISCARD, __func__, "there is no such status");
    }
    *value = 0;
    return OK;
}

REFUSED(GetStringStatus, DISCARD, "there is no such status", Component component, const fmi2StatusKind kind,
    String *value)

#else

/* --- functions of FMI 3.0 only: the model has no clocks and no structural parameters */

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
    String name, String token, Boolean logging, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log_message, int stepped) {
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
    String name, String token, String resources, Boolean visible, Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log_message) {
    return instantiate(name, token, logging, environment, log_message, 0);
}

EXPORTED Component FMI(InstantiateCoSimulation)(
    String name, String token, String resources, Boolean visible, Boolean logging, Boolean event_mode,
    Boolean early_return, const Reference required[], size_t count, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log_message, fmi3IntermediateUpdateCallback update) {
    if (event_mode || count > 0) {
        return NULL;
    }
    return instantiate(name, token, logging, environment, log_message, 1);
}

EXPORTED Component FMI(InstantiateScheduledExecution)(
    String name, String token, String resources, Boolean visible, Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log_message, fmi3ClockUpdateCallback clock,
    fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock) {
    return NULL;
}

EXPORTED Status FMI(EnterInitializationMode)(
    Component component, Boolean tolerant, Real tolerance, Real from, Boolean ends, Real end) {
    NEEDS(INSTANTIATED)
    if (!begin(model, tolerant, tolerance, from)) {
        FAIL("the tolerance is not positive");
    }
    model->now.phase = INITIALIZING;
    return OK;
}

EXPORTED Status FMI(GetFloat64)(Component component, REFERENCES, Real values[], size_t size) {
    NEEDS(INSTANTIATED | EVALUATING)
    if (size != count) {
        FAIL("the number of values is another");
    }
    GIVE(get_all(model, references, count, values));
}

EXPORTED Status FMI(SetFloat64)(Component component, REFERENCES, const Real values[], size_t size) {
    NEEDS(INSTANTIATED | EVALUATING)
    if (size != count) {
        FAIL("the number of values is another");
    }
    GIVE(set_all(model, references, count, values));
}

NONE(GetBinary, size_t sizes[], fmi3Binary values[], size_t size)
NONE(SetBinary, const size_t sizes[], const fmi3Binary values[], size_t size)
NONE(GetClock, fmi3Clock values[])
NONE(SetClock, const fmi3Clock values[])
NONE(GetIntervalDecimal, Real intervals[], fmi3IntervalQualifier qualifiers[])
NONE(GetIntervalFraction, fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
NONE(GetShiftDecimal, Real shifts[])
NONE(GetShiftFraction, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
NONE(SetIntervalDecimal, const Real intervals[])
NONE(SetIntervalFraction, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
NONE(SetShiftDecimal, const Real shifts[])
NONE(SetShiftFraction, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])

REFUSED(GetAdjointDerivative, ERROR, "there are directional derivatives only", Component component,
    const Reference unknowns[], size_t unknown_count, REFERENCES, const Real seed[], size_t seeds,
    Real sensitivity[], size_t sensitivities)
REFUSED(GetNumberOfVariableDependencies, ERROR, "dependencies do not change", Component component,
    Reference reference, size_t *count)

REFUSED(GetVariableDependencies, ERROR, "dependencies do not change", Component component,
    Reference dependent, size_t elements[], Reference independents[], size_t independent_elements[], fmi3DependencyKind kinds[], size_t count)

REFUSED(EnterConfigurationMode, ERROR, "there are no structural parameters", Component component)
REFUSED(ExitConfigurationMode, ERROR, "there are no structural parameters", Component component)

EXPORTED Status FMI(EvaluateDiscreteStates)(Component component) {
    NEEDS(INITIALIZING | EVENTS)
    return OK;
}

EXPORTED Status FMI(UpdateDiscreteStates)(
    Component component, Boolean *again, Boolean *terminate, Boolean *nominals_changed,
    Boolean *values_changed, Boolean *next_event, Real *next_event_time) {
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

REFUSED(EnterStepMode, ERROR, "co-simulation has no event mode", Component component)
NONE(GetOutputDerivatives, const fmi3Int32 orders[], Real values[], size_t size)

EXPORTED Status FMI(DoStep)(
    Component component, Real point, Real step, Boolean final, Boolean *event_handling, Boolean *terminate,
    Boolean *early_return, Real *last_time) {
    NEEDS(STEPPING)
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

REFUSED(ActivateModelPartition, ERROR, "there are no clocks", Component component, Reference clock, Real time)

#endif
