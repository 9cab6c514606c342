/* FMI 3.0 for co-simulation. */

#include "core.h"
#include "fmi3Functions.h"

static void report(Instance *instance, int status, const char *text) {
    ((fmi3LogMessageCallback)instance->logger)(instance->environment, (fmi3Status)status, "logStatusError", text);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    (void)on, (void)n, (void)categories;
    return c ? fmi3OK : fmi3Error;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                         fmi3Boolean visible, fmi3Boolean on, fmi3Boolean events,
                                         fmi3Boolean early, const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                         fmi3IntermediateUpdateCallback update) {
    (void)visible, (void)on, (void)events, (void)early, (void)required, (void)n, (void)update;
    return instantiate(name, token, resources, report, (void *)logger, environment);
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                          fmi3Boolean visible, fmi3Boolean on,
                                          fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger) {
    (void)name, (void)token, (void)resources, (void)visible, (void)on, (void)environment, (void)logger;
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean on,
                                               fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback logger, fmi3ClockUpdateCallback clock,
                                               fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock) {
    (void)name, (void)token, (void)resources, (void)visible, (void)on, (void)environment, (void)logger;
    (void)clock, (void)lock, (void)unlock;
    return NULL;
}

void fmi3FreeInstance(fmi3Instance c) { dispose(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    return enter_initialization(c, start);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return exit_initialization(c); }

fmi3Status fmi3Terminate(fmi3Instance c) { return terminate(c); }

fmi3Status fmi3Reset(fmi3Instance c) { return reset(c); }

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 value[],
                          size_t m) {
    return m == n ? get(c, r, n, 'r', value) : fmi3Error;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 value[],
                          size_t m) {
    return m == n ? set(c, r, n, 'r', value) : fmi3Error;
}

fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Int32 value[], size_t m) {
    double one = 0.0;
    for (size_t i = 0; i < n; i++) {
        if (m != n || get(c, r + i, 1, 'i', &one)) return fmi3Error;
        value[i] = (fmi3Int32)one;
    }
    return c ? fmi3OK : fmi3Error;
}

fmi3Status fmi3SetInt32(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Int32 value[],
                        size_t m) {
    for (size_t i = 0; i < n; i++) {
        double one = value[i];
        if (m != n || set(c, r + i, 1, 'i', &one)) return fmi3Error;
    }
    return c ? fmi3OK : fmi3Error;
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 h, fmi3Boolean final, fmi3Boolean *event,
                      fmi3Boolean *ended, fmi3Boolean *early, fmi3Float64 *last) {
    (void)final;
    int status = step(c, time, h);
    if (event) *event = fmi3False;
    if (ended) *ended = fmi3False;
    if (early) *early = fmi3False;
    if (last && c) *last = ((Instance *)c)->state.time;
    return (fmi3Status)status;
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *s) { return get_state(c, s); }

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState s) { return set_state(c, s); }

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *s) { return free_state(c, s); }

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState s, size_t *n) {
    return state_size(c, s, n);
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState s, fmi3Byte bytes[], size_t n) {
    return write_state(c, s, bytes, n);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t n, fmi3FMUState *s) {
    return read_state(c, bytes, n, s);
}

/* What the model description says it cannot do. */
static fmi3Status refused(void) { return fmi3Error; }

#define REFUSED(name) FMI3_Export name##TYPE name __attribute__((alias("refused")));
#define NO_VALUES(type) REFUSED(fmi3Get##type) REFUSED(fmi3Set##type)
NO_VALUES(Float32)
NO_VALUES(Int8)
NO_VALUES(UInt8)
NO_VALUES(Int16)
NO_VALUES(UInt16)
NO_VALUES(UInt32)
NO_VALUES(Int64)
NO_VALUES(UInt64)
NO_VALUES(Boolean)
NO_VALUES(String)
NO_VALUES(Binary)
NO_VALUES(Clock)
NO_VALUES(IntervalDecimal)
NO_VALUES(IntervalFraction)
REFUSED(fmi3GetShiftDecimal)
REFUSED(fmi3GetShiftFraction)
REFUSED(fmi3SetShiftDecimal)
REFUSED(fmi3SetShiftFraction)
REFUSED(fmi3GetNumberOfVariableDependencies)
REFUSED(fmi3GetVariableDependencies)
REFUSED(fmi3GetDirectionalDerivative)
REFUSED(fmi3GetAdjointDerivative)
REFUSED(fmi3GetOutputDerivatives)
REFUSED(fmi3EnterConfigurationMode)
REFUSED(fmi3ExitConfigurationMode)
REFUSED(fmi3EnterEventMode)
REFUSED(fmi3EnterStepMode)
REFUSED(fmi3EvaluateDiscreteStates)
REFUSED(fmi3UpdateDiscreteStates)
REFUSED(fmi3EnterContinuousTimeMode)
REFUSED(fmi3CompletedIntegratorStep)
REFUSED(fmi3SetTime)
REFUSED(fmi3SetContinuousStates)
REFUSED(fmi3GetContinuousStateDerivatives)
REFUSED(fmi3GetEventIndicators)
REFUSED(fmi3GetContinuousStates)
REFUSED(fmi3GetNominalsOfContinuousStates)
REFUSED(fmi3GetNumberOfEventIndicators)
REFUSED(fmi3GetNumberOfContinuousStates)
REFUSED(fmi3ActivateModelPartition)
