/* A simulation tool in plain C: loads a damper's library (FMI 3.0), and calls it in turn and out of turn. */

#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi3Functions.h"

#define TAKE(name) fmi3##name##TYPE *name = (fmi3##name##TYPE *)dlsym(library, "fmi3" #name)
#define EXPECT(condition) \
    if (!(condition)) return printf("line %d: %s\n", __LINE__, #condition), 1

static int messages = 0;

static void count(fmi3InstanceEnvironment e, fmi3Status s, fmi3String c, fmi3String text) {
    (void)e, (void)s, (void)c;
    messages += text && *text;
}

int main(int argc, char **argv) {
    EXPECT(argc == 3 && !getenv("PATH"));
    void *library = dlopen(argv[1], RTLD_NOW | RTLD_LOCAL);
    if (!library) return puts(dlerror()), 1;
    TAKE(InstantiateCoSimulation);
    TAKE(FreeInstance);
    TAKE(EnterInitializationMode);
    TAKE(ExitInitializationMode);
    TAKE(Terminate);
    TAKE(Reset);
    TAKE(GetFloat64);
    TAKE(SetFloat64);
    TAKE(SetInt32);
    TAKE(GetString);
    TAKE(DoStep);
    TAKE(GetFMUState);
    TAKE(SetFMUState);
    TAKE(FreeFMUState);
    fmi3Boolean no;
    fmi3Float64 last, force[2] = {0, 0}, ends[2], zero = 0.0, nan = NAN;
    const fmi3ValueReference motion[2] = {1, 2}, forces[2] = {7, 8}, wild = 4000000000u, how = 13;
    const fmi3Int32 reached = 2;
    const double h = 5e-4, omega = 2.0 * 3.14159265358979323846 * 3.0;
    const double amplitude = 4e-3;
    EXPECT(!InstantiateCoSimulation("x", "other", "", 0, 0, 0, 0, NULL, 0, NULL, count, NULL));
    EXPECT(!InstantiateCoSimulation("x", NULL, NULL, 0, 0, 0, 0, NULL, 0, NULL, NULL, NULL));
    EXPECT(DoStep(NULL, 0, h, 1, &no, &no, &no, &last) == fmi3Error);
    fmi3Instance one = InstantiateCoSimulation("one", argv[2], "", 0, 0, 0, 0, NULL, 0, NULL, count, NULL);
    fmi3Instance two = InstantiateCoSimulation(NULL, argv[2], NULL, 0, 0, 0, 0, NULL, 0, NULL, NULL, NULL);
    EXPECT(one && two);
    messages = 0;
    EXPECT(DoStep(one, 0, h, 1, &no, &no, &no, &last) == fmi3Error);
    EXPECT(Terminate(one) == fmi3Error);
    EXPECT(ExitInitializationMode(one) == fmi3Error);
    EXPECT(GetFloat64(one, &wild, 1, force, 1) == fmi3Error);
    EXPECT(SetFloat64(one, forces, 2, force, 2) == fmi3Error); /* outputs */
    EXPECT(SetFloat64(one, motion, 1, &nan, 1) == fmi3Error);
    EXPECT(GetString(one, NULL, 0, NULL, 0) == fmi3Error);
    EXPECT(messages == 6);
    for (int i = 0; i < 2; i++) {
        fmi3Instance c = i ? two : one;
        ends[0] = 0.0, ends[1] = amplitude * omega;
        EXPECT(SetInt32(c, &how, 1, &reached, 1) == fmi3OK);
        EXPECT(SetFloat64(c, motion, 2, ends, 2) == fmi3OK);
        EXPECT(EnterInitializationMode(c, 0, 0, 0, 0, 0) == fmi3OK);
        EXPECT(EnterInitializationMode(c, 0, 0, 0, 0, 0) == fmi3Error);
        EXPECT(ExitInitializationMode(c) == fmi3OK);
    }
    EXPECT(SetInt32(one, &how, 1, &reached, 1) == fmi3Error); /* a parameter, too late */
    EXPECT(DoStep(one, 1.0, h, 1, &no, &no, &no, &last) == fmi3Error); /* another time */
    EXPECT(DoStep(one, 0.0, -h, 1, &no, &no, &no, &last) == fmi3Error);
    fmi3FMUState saved = NULL;
    double before[2];
    for (int n = 0; n < 400; n++) {
        const double t = (n + 1) * h;
        ends[0] = amplitude * sin(omega * t), ends[1] = amplitude * omega * cos(omega * t);
        EXPECT(SetFloat64(one, motion, 2, ends, 2) == fmi3OK);
        if (n == 200) EXPECT(GetFMUState(one, &saved) == fmi3OK);
        EXPECT(DoStep(one, n * h, h, 1, &no, &no, &no, &last) == fmi3OK);
        if (n == 200) {
            EXPECT(GetFloat64(one, forces, 2, before, 2) == fmi3OK);
            EXPECT(SetFMUState(one, saved) == fmi3OK);
            EXPECT(DoStep(one, n * h, h, 1, &no, &no, &no, &last) == fmi3OK);
            EXPECT(GetFloat64(one, forces, 2, force, 2) == fmi3OK);
            EXPECT(force[0] == before[0] && force[1] == before[1]);
            EXPECT(FreeFMUState(one, &saved) == fmi3OK && !saved);
        }
    }
    EXPECT(GetFloat64(one, forces, 2, force, 2) == fmi3OK);
    printf("%.17g %.17g\n", force[0], force[1]);
    EXPECT(GetFloat64(two, forces, 2, force, 2) == fmi3OK);
    EXPECT(force[0] == zero && force[1] == zero); /* the other one has not moved */
    EXPECT(Terminate(one) == fmi3OK);
    EXPECT(DoStep(one, 0.2, h, 1, &no, &no, &no, &last) == fmi3Error);
    EXPECT(Reset(one) == fmi3OK && Reset(two) == fmi3OK);
    EXPECT(DoStep(two, 0.0, h, 1, &no, &no, &no, &last) == fmi3Error);
    FreeInstance(one);
    FreeInstance(two);
    FreeInstance(NULL);
    return dlclose(library);
}
