/* FMI 2.0 for co-simulation. */

#include "core.h"
#include "fmi2Functions.h"

static void report(Instance *instance, int status, const char *text) {
    ((fmi2CallbackLogger)instance->logger)(instance->environment, instance->name, (fmi2Status)status,
                                           "logStatusError", "%s", text);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    (void)on, (void)n, (void)categories;
    return c ? fmi2OK : fmi2Error;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean on) {
    (void)visible, (void)on;
    if (type != fmi2CoSimulation) return NULL;
    const char *path = resources ? resources : "";
    if (strncmp(path, "file:", 5) == 0) path += 5; /* file:/path, file:///path and file://host/path */
    if (strncmp(path, "//", 2) == 0) path = strchr(path + 2, '/') ? strchr(path + 2, '/') : path;
    void *logger = functions ? (void *)functions->logger : NULL;
    Instance *made =
        instantiate(name, token, path, report, logger, functions ? functions->componentEnvironment : NULL);
    for (char *p = made ? made->resources : NULL, *q = p; p && (*q = *p); p++, q++) {
        unsigned code; /* %20 and the like */
        if (*p == '%' && sscanf(p + 1, "%2x", &code) == 1) *q = (char)code, p += 2;
    }
    return made;
}

void fmi2FreeInstance(fmi2Component c) { dispose(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    if (!ready(c, INSTANTIATED, "SetupExperiment")) return fmi2Error;
    ((Instance *)c)->state.time = start;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    return c ? enter_initialization(c, ((Instance *)c)->state.time) : fmi2Error;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return exit_initialization(c); }

fmi2Status fmi2Terminate(fmi2Component c) { return terminate(c); }

fmi2Status fmi2Reset(fmi2Component c) { return reset(c); }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[]) {
    return get(c, r, n, 'r', value);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real value[]) {
    return set(c, r, n, 'r', value);
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer value[]) {
    double one = 0.0;
    for (size_t i = 0; i < n; i++) {
        if (get(c, r + i, 1, 'i', &one)) return fmi2Error;
        value[i] = (fmi2Integer)one;
    }
    return c ? fmi2OK : fmi2Error;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer value[]) {
    for (size_t i = 0; i < n; i++) {
        double one = value[i];
        if (set(c, r + i, 1, 'i', &one)) return fmi2Error;
    }
    return c ? fmi2OK : fmi2Error;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real h, fmi2Boolean final) {
    (void)final;
    return step(c, time, h);
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s) { return get_state(c, s); }

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) { return set_state(c, s); }

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s) { return free_state(c, s); }

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n) {
    return state_size(c, s, n);
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte bytes[], size_t n) {
    return write_state(c, s, bytes, n);
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t n, fmi2FMUstate *s) {
    return read_state(c, bytes, n, s);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (!c || !value || kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Instance *)c)->state.time;
    return fmi2OK;
}

/* What the model description says it cannot do. */
static fmi2Status refused(void) { return fmi2Error; }

#define REFUSED(name) FMI2_Export name##TYPE name __attribute__((alias("refused")));
REFUSED(fmi2GetBoolean)
REFUSED(fmi2SetBoolean)
REFUSED(fmi2GetString)
REFUSED(fmi2SetString)
REFUSED(fmi2GetDirectionalDerivative)
REFUSED(fmi2SetRealInputDerivatives)
REFUSED(fmi2GetRealOutputDerivatives)
REFUSED(fmi2CancelStep)
REFUSED(fmi2GetStatus)
REFUSED(fmi2GetIntegerStatus)
REFUSED(fmi2GetBooleanStatus)
REFUSED(fmi2GetStringStatus)
