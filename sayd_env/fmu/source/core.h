/* What FMI 2.0 and 3.0 have in common: an instance, its values, and in which order it may be called.

   model.h, written by the export, holds the variables and the sizes; a model (damper.c or process.c) has the
   four functions below. Functions that are called out of turn or with something invalid say why and do
   nothing. */

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

enum { STATUS_OK = 0, STATUS_DISCARD = 2, STATUS_ERROR = 3 }; /* the same in both versions */
enum { INSTANTIATED = 1, INITIALIZING = 2, STEPPING = 4, TERMINATED = 8, FAILED = 16, ANY = 31 };

typedef struct {
    double value[VARIABLES];
    double memory[MEMORY + 1];
    double time;
    int phase;
    char token[sizeof TOKEN];
} State;

typedef struct Instance {
    State state;
    void *own; /* what a model has outside of its state */
    char *resources;
    char *name;
    void (*log)(struct Instance *instance, int status, const char *text);
    void *logger;
    void *environment;
} Instance;

/* Each returns NULL or what went wrong, in memory that lives as long as the instance or for ever. */
static const char *model_start(Instance *instance);
static const char *model_step(Instance *instance, double h);
static void model_stop(Instance *instance);
static void model_rest(State *state);

static int fail(Instance *instance, const char *format, ...) {
    char text[600];
    va_list rest;
    va_start(rest, format);
    vsnprintf(text, sizeof text, format, rest);
    va_end(rest);
    if (instance->log) instance->log(instance, STATUS_ERROR, text);
    return STATUS_ERROR;
}

static const char *phase_name(int phase) {
    return phase == INSTANTIATED   ? "after instantiation"
           : phase == INITIALIZING ? "in initialization mode"
           : phase == STEPPING     ? "between steps"
           : phase == TERMINATED   ? "after termination"
                                   : "after an error";
}

/* Whether a function may be called now. */
static int ready(Instance *instance, int phases, const char *function) {
    if (!instance) return 0;
    if (instance->state.phase & phases) return 1;
    fail(instance, "%s: not allowed %s", function, phase_name(instance->state.phase));
    return 0;
}

static char *copied(const char *text) {
    char *copy = malloc(strlen(text ? text : "") + 1);
    if (copy) strcpy(copy, text ? text : "");
    return copy;
}

static void rest(State *state) {
    memset(state, 0, sizeof *state);
    for (int i = 0; i < VARIABLES; i++) state->value[i] = START[i];
    state->phase = INSTANTIATED;
    memcpy(state->token, TOKEN, sizeof TOKEN);
    model_rest(state);
}

static void dispose(Instance *instance) {
    if (!instance) return;
    model_stop(instance);
    free(instance->resources);
    free(instance->name);
    free(instance);
}

/* NULL if the token is that of another model description or memory is short. */
static Instance *instantiate(const char *name, const char *token, const char *resources,
                             void (*log)(Instance *, int, const char *), void *logger, void *environment) {
    Instance *instance = calloc(1, sizeof *instance);
    if (!instance) return NULL;
    instance->log = logger ? log : NULL;
    instance->logger = logger;
    instance->environment = environment;
    instance->name = copied(name);
    instance->resources = copied(resources);
    rest(&instance->state);
    if (!instance->name || !instance->resources || !token || strcmp(token, TOKEN) != 0) {
        fail(instance, "instantiation: found token %s, expected %s", token ? token : "none", TOKEN);
        dispose(instance);
        return NULL;
    }
    return instance;
}

static int enter_initialization(Instance *instance, double start) {
    if (!ready(instance, INSTANTIATED, "EnterInitializationMode")) return STATUS_ERROR;
    instance->state.time = instance->state.value[0] = start;
    instance->state.phase = INITIALIZING;
    return STATUS_OK;
}

static int exit_initialization(Instance *instance) {
    if (!ready(instance, INITIALIZING, "ExitInitializationMode")) return STATUS_ERROR;
    const char *trouble = model_start(instance);
    instance->state.phase = trouble ? FAILED : STEPPING;
    return trouble ? fail(instance, "%s", trouble) : STATUS_OK;
}

static int terminate(Instance *instance) {
    if (!ready(instance, STEPPING, "Terminate")) return STATUS_ERROR;
    instance->state.phase = TERMINATED;
    return STATUS_OK;
}

static int reset(Instance *instance) {
    if (!ready(instance, ANY, "Reset")) return STATUS_ERROR;
    model_stop(instance);
    rest(&instance->state);
    return STATUS_OK;
}

static int step(Instance *instance, double time, double h) {
    if (!ready(instance, STEPPING, "DoStep")) return STATUS_ERROR;
    State *state = &instance->state;
    if (!(h > 0.0 && h <= 1e3)) return fail(instance, "DoStep: found a step of %g s", h);
    if (!(fabs(time - state->time) <= 1e-3 * h + 1e-9))
        return fail(instance, "DoStep: found time %.9g s, the last step ended at %.9g s", time, state->time);
    const char *trouble = model_step(instance, h);
    if (trouble) {
        state->phase = FAILED;
        return fail(instance, "DoStep from %g s over %g s: %s", time, h, trouble);
    }
    state->time = state->value[0] = time + h;
    return STATUS_OK;
}

static int known(Instance *instance, unsigned reference, char type) {
    if (reference < VARIABLES && TYPE[reference] == type) return 1;
    fail(instance, "value reference %u: no variable of this type", reference);
    return 0;
}

static int get(Instance *instance, const unsigned reference[], size_t count, char type, double *value) {
    if (!ready(instance, ANY, "Get") || (count && (!reference || !value))) return STATUS_ERROR;
    /* Outputs follow the inputs and parameters that have been set. */
    if (PLAIN && instance->state.phase == INITIALIZING) model_start(instance);
    for (size_t i = 0; i < count; i++) {
        if (!known(instance, reference[i], type)) return STATUS_ERROR;
        value[i] = instance->state.value[reference[i]];
    }
    return STATUS_OK;
}

static int set_one(Instance *instance, unsigned reference, char type, double value) {
    if (!known(instance, reference, type)) return STATUS_ERROR;
    const char *name = NAME[reference];
    int input = KIND[reference] == 'i';
    if (!input && KIND[reference] != 'p') return fail(instance, "%s: is not an input or parameter", name);
    if (!input && instance->state.phase == STEPPING)
        return fail(instance, "%s: a parameter is fixed after initialization", name);
    if (!isfinite(value) || value < LOW[reference] || value > HIGH[reference])
        return fail(instance, "%s: found %g, allowed are %g to %g", name, value, LOW[reference], HIGH[reference]);
    instance->state.value[reference] = value;
    return STATUS_OK;
}

static int set(Instance *instance, const unsigned reference[], size_t count, char type, const double *value) {
    if (!ready(instance, INSTANTIATED | INITIALIZING | STEPPING, "Set")) return STATUS_ERROR;
    if (count && (!reference || !value)) return STATUS_ERROR;
    for (size_t i = 0; i < count; i++)
        if (set_one(instance, reference[i], type, value[i])) return STATUS_ERROR;
    return STATUS_OK;
}

static int can_save(Instance *instance, const void *argument) {
    if (!ready(instance, ANY, "FMU state")) return 0;
    if (PLAIN && argument) return 1;
    fail(instance, PLAIN ? "FMU state: found none" : "FMU state: this unit's cannot be saved");
    return 0;
}

static int get_state(Instance *instance, void **saved) {
    if (!can_save(instance, saved)) return STATUS_ERROR;
    if (!*saved && !(*saved = malloc(sizeof(State)))) return fail(instance, "FMU state: no memory");
    memcpy(*saved, &instance->state, sizeof(State));
    return STATUS_OK;
}

static int set_state(Instance *instance, const void *saved) {
    if (!can_save(instance, saved)) return STATUS_ERROR;
    memcpy(&instance->state, saved, sizeof(State));
    return STATUS_OK;
}

static int free_state(Instance *instance, void **saved) {
    if (!instance || !saved) return STATUS_ERROR;
    free(*saved);
    *saved = NULL;
    return STATUS_OK;
}

static int state_size(Instance *instance, const void *saved, size_t *size) {
    if (!can_save(instance, saved) || !size) return STATUS_ERROR;
    *size = sizeof(State);
    return STATUS_OK;
}

static int write_state(Instance *instance, const void *saved, void *bytes, size_t size) {
    if (!can_save(instance, saved) || !bytes) return STATUS_ERROR;
    if (size < sizeof(State)) return fail(instance, "FMU state: found room for %zu bytes", size);
    memcpy(bytes, saved, sizeof(State));
    return STATUS_OK;
}

static int read_state(Instance *instance, const void *bytes, size_t size, void **saved) {
    if (!can_save(instance, saved) || !bytes) return STATUS_ERROR;
    if (size != sizeof(State) || memcmp((const char *)bytes + offsetof(State, token), TOKEN, sizeof TOKEN))
        return fail(instance, "FMU state: found %zu bytes that are not this unit's", size);
    if (!*saved && !(*saved = malloc(sizeof(State)))) return fail(instance, "FMU state: no memory");
    memcpy(*saved, bytes, sizeof(State));
    return STATUS_OK;
}

#include MODEL
