/* The damper: machine code of the kernel sayd_env.physics.coupled.couple and what it starts from. */

#include <stdint.h>

/* A flat array as compiled kernels take it: owner (none), size, bytes of an element, data, size, stride. */
#define ARRAY(data, size) NULL, NULL, (int64_t)(size), (int64_t)8, (data), (int64_t)(size), (int64_t)8

extern int32_t sayd_couple(int64_t *result, void **error, double h, void *, void *, int64_t, int64_t,
                                double *value, int64_t, int64_t, void *, void *, int64_t, int64_t,
                                double *memory, int64_t, int64_t, void *, void *, int64_t, int64_t,
                                const double *table, int64_t, int64_t);

static const char *advance(Instance *instance, double h) {
    int64_t result = 0;
    void *error = NULL;
    State *state = &instance->state;
    sayd_couple(&result, &error, h, ARRAY(state->value, VARIABLES), ARRAY(state->memory, MEMORY),
                     ARRAY(TABLE, sizeof TABLE / sizeof *TABLE));
    if (result == 1) return "so short a step cannot hold the delay of the valve's driver";
    if (result == 2) return "the damper's state is no longer finite; check displacements and velocities";
    return NULL;
}

static const char *model_start(Instance *instance) { return advance(instance, 0.0); }

static const char *model_step(Instance *instance, double h) { return advance(instance, h); }

static void model_stop(Instance *instance) { (void)instance; }

static void model_rest(State *state) {
    for (size_t i = 0; i < sizeof RESTING / sizeof *RESTING; i++) state->memory[i] = RESTING[i];
}
