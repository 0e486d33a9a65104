/* The machine of nominal.py as an FMU for co-simulation: -DFMI=2 or -DFMI=3. */
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>

enum { OK = 0, ERROR = 3 };
enum { VOLTAGE, MASS, MOTOR_ANGLE, JOINT_ANGLE, MOTOR_SPEED, CURRENT, SEED, VARIABLES };
static const double KM = 0.03, KE = 0.02588, R = 1.56, L = 0.00132, GEAR = 100.0;
static const double J = 0.204, MC = 6.825, MS = 12.025, OMEGA_SF = 0.0557, SIGMA_2 = 5.3462;
static const double MU_C = 0.052, MU_S = 0.086, OMEGA_SL = 0.0326, MU_2 = 0.032;

typedef void (*Log2)(void *, const char *, int, const char *, const char *, ...);
typedef void (*Log3)(void *, int, const char *, const char *);
typedef struct {
    double value[VARIABLES], angle, speed, current;
    Log2 log2;
    Log3 log3;
} Machine;

static double friction(double speed, double moment) {
    double own = speed / OMEGA_SF, load = speed / OMEGA_SL;
    return MC + (MS - MC) * exp(-own * own) + SIGMA_2 * speed
        + moment * (MU_C + (MU_S - MU_C) * exp(-load * load) + MU_2 * speed);
}

static int advance(Machine *m, double dt) {
    double h = dt / 2, decay = exp(-h * R / L), moment = 10.0 * m->value[MASS] * 9.80665 * 0.095;
    if (m->value[MASS] > 99.0) {
        const char *words = "the lever breaks";
        if (m->log2) m->log2(NULL, "machine", ERROR, "error", words);
        if (m->log3) m->log3(NULL, ERROR, "error", words);
        return ERROR;
    }
    for (int k = 0; k < 2; k++) {
        double before = m->current, settled = (m->value[VOLTAGE] - KE * GEAR * m->speed) / R;
        m->current = settled + (before - settled) * decay;
        double free = m->speed + h * KM * GEAR * 0.5 * (before + m->current) / J;
        double left = fabs(free) - h * friction(fabs(m->speed), moment) / J;
        m->speed = copysign(left > 0.0 ? left : 0.0, free);
        m->angle += h * m->speed;
    }
    m->value[MOTOR_ANGLE] = GEAR * m->angle;
    m->value[JOINT_ANGLE] = m->angle;
    m->value[MOTOR_SPEED] = GEAR * m->speed;
    /* A seed other than 0 shows in the current. */
    m->value[CURRENT] = m->current + 1e-3 * m->value[SEED];
    return OK;
}

static int set(Machine *m, const unsigned *at, size_t n, const double *value) {
    for (size_t k = 0; k < n; k++) m->value[at[k]] = value[k];
    return OK;
}

static int get(Machine *m, const unsigned *at, size_t n, double *value) {
    for (size_t k = 0; k < n; k++) value[k] = m->value[at[k]];
    return OK;
}

static int reset(Machine *m) {
    for (int k = 0; k < VARIABLES; k++) m->value[k] = 0.0;
    m->angle = m->speed = m->current = 0.0;
    return OK;
}

#define UNUSED(name) int name(void) { return ERROR; }
#define DONE(name) int name(void *m) { (void)m; return OK; }
#if FMI == 2
typedef struct { Log2 log; } Callbacks;
const char *fmi2GetVersion(void) { return "2.0"; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
void *fmi2Instantiate(const char *name, int kind, const char *guid, const char *place,
                      const Callbacks *callbacks) {
    Machine *m = calloc(1, sizeof(Machine));
    m->log2 = callbacks->log;
    return m;
}
void fmi2FreeInstance(void *m) { free(m); }
int fmi2DoStep(Machine *m, double time, double dt) { return advance(m, dt); }
int fmi2SetReal(Machine *m, const unsigned *at, size_t n, const double *v) { return set(m, at, n, v); }
int fmi2GetReal(Machine *m, const unsigned *at, size_t n, double *v) { return get(m, at, n, v); }
int fmi2SetInteger(Machine *m, const unsigned *at, size_t n, const int *v) {
    m->value[SEED] = *v;
    return OK;
}
DONE(fmi2SetupExperiment) DONE(fmi2EnterInitializationMode) DONE(fmi2ExitInitializationMode)
DONE(fmi2Terminate)
int fmi2Reset(Machine *m) { return reset(m); }
UNUSED(fmi2CancelStep) UNUSED(fmi2DeSerializeFMUstate) UNUSED(fmi2FreeFMUstate)
UNUSED(fmi2GetBoolean) UNUSED(fmi2GetBooleanStatus) UNUSED(fmi2GetDirectionalDerivative)
UNUSED(fmi2GetFMUstate) UNUSED(fmi2GetInteger) UNUSED(fmi2GetIntegerStatus)
UNUSED(fmi2GetRealOutputDerivatives) UNUSED(fmi2GetRealStatus) UNUSED(fmi2GetStatus)
UNUSED(fmi2GetString) UNUSED(fmi2GetStringStatus) UNUSED(fmi2SerializeFMUstate)
UNUSED(fmi2SerializedFMUstateSize) UNUSED(fmi2SetBoolean) UNUSED(fmi2SetDebugLogging)
UNUSED(fmi2SetFMUstate) UNUSED(fmi2SetRealInputDerivatives) UNUSED(fmi2SetString)
#else
const char *fmi3GetVersion(void) { return "3.0"; }
void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *place,
                                  bool visible, bool logging, bool events, bool early,
                                  const unsigned *needed, size_t n, void *environment, Log3 log) {
    Machine *m = calloc(1, sizeof(Machine));
    m->log3 = log;
    return m;
}
void fmi3FreeInstance(void *m) { free(m); }
int fmi3DoStep(Machine *m, double time, double dt, bool never_back, bool *event, bool *end,
               bool *early, double *last) {
    *event = *early = false;
    *end = m->value[MASS] == 77.0;
    *last = time + dt;
    return advance(m, dt);
}
int fmi3SetFloat64(Machine *m, const unsigned *at, size_t n, const double *v) { return set(m, at, n, v); }
int fmi3GetFloat64(Machine *m, const unsigned *at, size_t n, double *v) { return get(m, at, n, v); }
int fmi3SetInt32(Machine *m, const unsigned *at, size_t n, const int *v) {
    m->value[SEED] = *v;
    return OK;
}
DONE(fmi3EnterInitializationMode) DONE(fmi3ExitInitializationMode) DONE(fmi3Terminate)
int fmi3Reset(Machine *m) { return reset(m); }
UNUSED(fmi3ActivateModelPartition) UNUSED(fmi3CompletedIntegratorStep)
UNUSED(fmi3DeserializeFMUState) UNUSED(fmi3EnterConfigurationMode)
UNUSED(fmi3EnterContinuousTimeMode) UNUSED(fmi3EnterEventMode) UNUSED(fmi3EnterStepMode)
UNUSED(fmi3EvaluateDiscreteStates) UNUSED(fmi3ExitConfigurationMode) UNUSED(fmi3FreeFMUState)
UNUSED(fmi3GetAdjointDerivative) UNUSED(fmi3GetBinary) UNUSED(fmi3GetBoolean) UNUSED(fmi3GetClock)
UNUSED(fmi3GetContinuousStateDerivatives) UNUSED(fmi3GetContinuousStates)
UNUSED(fmi3GetDirectionalDerivative) UNUSED(fmi3GetEventIndicators) UNUSED(fmi3GetFMUState)
UNUSED(fmi3GetFloat32) UNUSED(fmi3GetInt16) UNUSED(fmi3GetInt32) UNUSED(fmi3GetInt64)
UNUSED(fmi3GetInt8) UNUSED(fmi3GetIntervalDecimal) UNUSED(fmi3GetIntervalFraction)
UNUSED(fmi3GetNominalsOfContinuousStates) UNUSED(fmi3GetNumberOfContinuousStates)
UNUSED(fmi3GetNumberOfEventIndicators) UNUSED(fmi3GetNumberOfVariableDependencies)
UNUSED(fmi3GetOutputDerivatives) UNUSED(fmi3GetShiftDecimal) UNUSED(fmi3GetShiftFraction)
UNUSED(fmi3GetString) UNUSED(fmi3GetUInt16) UNUSED(fmi3GetUInt32) UNUSED(fmi3GetUInt64)
UNUSED(fmi3GetUInt8) UNUSED(fmi3GetVariableDependencies) UNUSED(fmi3InstantiateModelExchange)
UNUSED(fmi3InstantiateScheduledExecution) UNUSED(fmi3SerializeFMUState)
UNUSED(fmi3SerializedFMUStateSize) UNUSED(fmi3SetBinary) UNUSED(fmi3SetBoolean)
UNUSED(fmi3SetClock) UNUSED(fmi3SetContinuousStates) UNUSED(fmi3SetDebugLogging)
UNUSED(fmi3SetFMUState) UNUSED(fmi3SetFloat32) UNUSED(fmi3SetInt16) UNUSED(fmi3SetInt64)
UNUSED(fmi3SetInt8) UNUSED(fmi3SetIntervalDecimal) UNUSED(fmi3SetIntervalFraction)
UNUSED(fmi3SetShiftDecimal) UNUSED(fmi3SetShiftFraction) UNUSED(fmi3SetString) UNUSED(fmi3SetTime)
UNUSED(fmi3SetUInt16) UNUSED(fmi3SetUInt32) UNUSED(fmi3SetUInt64) UNUSED(fmi3SetUInt8)
UNUSED(fmi3UpdateDiscreteStates)
#endif
