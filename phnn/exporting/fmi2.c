/* FMI 2.0 co-simulation around the model, with the declarations of the standard that it needs.
 *
 * A communication step is a whole number of the model's steps. The input keeps the value that was set, or follows it
 * with the derivative that was set. MODEL, INPUTS, GUID and the calls in braces are filled in at the export. */
#include "@MODEL@.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define EXPORTED __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif
#ifdef FMI2_FUNCTION_PREFIX
#define JOINED(a, b) a##b
#define PREFIXED(a, b) JOINED(a, b)
#define FMI(name) PREFIXED(FMI2_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Char;
typedef const fmi2Char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

enum { INPUTS = @INPUTS@, OUTPUT = INPUTS };
/* Share of a step by which a communication step may miss a whole number of them. */
static const double MISSED = 1e-6;

typedef struct {
    @MODEL@_state model;
    double u[INPUTS], rate[INPUTS], time;
    int begun;
    const fmi2CallbackFunctions *callbacks;
    char name[64];
} instance;

static fmi2Status refused(const instance *i, const char *text) {
    if (i->callbacks && i->callbacks->logger)
        i->callbacks->logger(i->callbacks->componentEnvironment, i->name, fmi2Error, "error", text);
    return fmi2Error;
}

static void begin(instance *i) {
    const double *u = i->u;
    @MODEL@_init(&i->model, @INIT@);
}

EXPORTED const char *FMI(fmi2GetTypesPlatform)(void) { return "default"; }
EXPORTED const char *FMI(fmi2GetVersion)(void) { return "2.0"; }
EXPORTED fmi2Status FMI(fmi2SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK;
}

EXPORTED fmi2Component FMI(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                            const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                                            fmi2Boolean logging) {
    instance *i;
    (void)resources, (void)visible, (void)logging;
    if (type != fmi2CoSimulation || !guid || strcmp(guid, "@GUID@")) return NULL;
    i = callbacks && callbacks->allocateMemory ? callbacks->allocateMemory(1, sizeof *i) : calloc(1, sizeof *i);
    if (!i) return NULL;
    memset(i, 0, sizeof *i);
    i->callbacks = callbacks;
    strncpy(i->name, name ? name : "@MODEL@", sizeof i->name - 1);
    begin(i);
    return i;
}

EXPORTED void FMI(fmi2FreeInstance)(fmi2Component c) {
    instance *i = c;
    if (!i) return;
    if (i->callbacks && i->callbacks->freeMemory) i->callbacks->freeMemory(i);
    else free(i);
}

EXPORTED fmi2Status FMI(fmi2SetupExperiment)(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                                             fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop) {
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    ((instance *)c)->time = start;
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2EnterInitializationMode)(fmi2Component c) {
    begin(c);
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2ExitInitializationMode)(fmi2Component c) {
    begin(c);
    ((instance *)c)->begun = 1;
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2Terminate)(fmi2Component c) {
    (void)c;
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2Reset)(fmi2Component c) {
    instance *i = c;
    memset(i->u, 0, sizeof i->u);
    memset(i->rate, 0, sizeof i->rate);
    i->begun = 0;
    begin(i);
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2GetReal)(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[]) {
    instance *i = c;
    if (!i->begun) begin(i);
    for (size_t k = 0; k < n; k++) {
        if (r[k] > OUTPUT) return refused(i, "no such variable");
        value[k] = r[k] == OUTPUT ? @MODEL@_output(&i->model) : i->u[r[k]];
    }
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2SetReal)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real value[]) {
    instance *i = c;
    for (size_t k = 0; k < n; k++) {
        if (r[k] >= INPUTS) return refused(i, "only inputs can be set");
        i->u[r[k]] = value[k];
        i->rate[r[k]] = 0.0;
    }
    return fmi2OK;
}

/* There are no variables of other types. */
#define NO_VARIABLES(get, set, kind)                                                                                  \
    EXPORTED fmi2Status FMI(get)(fmi2Component c, const fmi2ValueReference r[], size_t n, kind value[]) {              \
        (void)r, (void)value;                                                                                         \
        return n ? refused(c, "no such variable") : fmi2OK;                                                           \
    }                                                                                                                 \
    EXPORTED fmi2Status FMI(set)(fmi2Component c, const fmi2ValueReference r[], size_t n, const kind value[]) {        \
        (void)r, (void)value;                                                                                         \
        return n ? refused(c, "no such variable") : fmi2OK;                                                           \
    }
NO_VARIABLES(fmi2GetInteger, fmi2SetInteger, fmi2Integer)
NO_VARIABLES(fmi2GetBoolean, fmi2SetBoolean, fmi2Boolean)
NO_VARIABLES(fmi2GetString, fmi2SetString, fmi2String)

EXPORTED fmi2Status FMI(fmi2SetRealInputDerivatives)(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                                     const fmi2Integer order[], const fmi2Real value[]) {
    instance *i = c;
    for (size_t k = 0; k < n; k++) {
        if (r[k] >= INPUTS || order[k] != 1) return refused(i, "only first derivatives of inputs can be set");
        i->rate[r[k]] = value[k];
    }
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2GetRealOutputDerivatives)(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                                      const fmi2Integer order[], fmi2Real value[]) {
    (void)r, (void)order, (void)value;
    return n ? refused(c, "derivatives of outputs are not given") : fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2DoStep)(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean final) {
    instance *i = c;
    const double step = @MODEL_UPPER@_DT / @SUBSTEPS@, count = floor(size / step + 0.5);
    (void)final;
    if (count < 1.0 || fabs(size / step - count) > MISSED * count)
        return refused(i, "the communication step is no whole number of the model's steps");
    for (double n = 0.0; n < count; n += 1.0) {
        const double at[3] = {n * step, (n + 0.5) * step, (n + 1.0) * step};
        const double *u = i->u, *rate = i->rate;
        if (@MODEL@_substep(&i->model, @SUBSTEP@) < 1.0) return refused(i, "a step has no solution");
    }
    for (int k = 0; k < INPUTS; k++) i->u[k] += i->rate[k] * size;
    i->time = time + size;
    return fmi2OK;
}

EXPORTED fmi2Status FMI(fmi2CancelStep)(fmi2Component c) { return refused(c, "steps end at once"); }
EXPORTED fmi2Status FMI(fmi2GetStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    (void)c, (void)kind;
    *value = fmi2OK;
    return fmi2OK;
}
EXPORTED fmi2Status FMI(fmi2GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    *value = ((instance *)c)->time;
    return kind == fmi2LastSuccessfulTime ? fmi2OK : fmi2Discard;
}
EXPORTED fmi2Status FMI(fmi2GetIntegerStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}
EXPORTED fmi2Status FMI(fmi2GetBooleanStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    (void)c;
    *value = 0;
    return kind == fmi2Terminated ? fmi2OK : fmi2Discard;
}
EXPORTED fmi2Status FMI(fmi2GetStringStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

/* A state is a copy of the instance. */
EXPORTED fmi2Status FMI(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *state) {
    if (!*state) *state = malloc(sizeof(instance));
    if (!*state) return refused(c, "no memory for a state");
    memcpy(*state, c, sizeof(instance));
    return fmi2OK;
}
EXPORTED fmi2Status FMI(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate state) {
    memcpy(c, state, sizeof(instance));
    return fmi2OK;
}
EXPORTED fmi2Status FMI(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *state) {
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}
EXPORTED fmi2Status FMI(fmi2SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size) {
    (void)state, (void)size;
    return refused(c, "states are not serialised");
}
EXPORTED fmi2Status FMI(fmi2SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    (void)state, (void)bytes, (void)size;
    return refused(c, "states are not serialised");
}
EXPORTED fmi2Status FMI(fmi2DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                                 fmi2FMUstate *state) {
    (void)bytes, (void)size, (void)state;
    return refused(c, "states are not serialised");
}
EXPORTED fmi2Status FMI(fmi2GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference unknown[], size_t n,
                                                      const fmi2ValueReference known[], size_t m,
                                                      const fmi2Real change[], fmi2Real value[]) {
    (void)unknown, (void)n, (void)known, (void)m, (void)change, (void)value;
    return refused(c, "directional derivatives are not given");
}
