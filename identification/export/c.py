"""The machine as C99 without dependencies, and as an S-function of Simulink around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from identification.export.machine import INPUTS, OUTPUTS, SIGNALS, Machine
from identification.export.printed import Language, derived, number, roots_of, statements
from identification.export.symbols import Node

C = Language(
    forms={
        "power": "power({0}, {1})",
        "sign": "sign({0})",
        "choose": "({0} ? {1} : {2})",
        "and": "({0} && {1})",
        "or": "({0} || {1})",
        "not": "(!{0})",
        "abs": "fabs({0})",
        "min": "fmin({0}, {1})",
        "max": "fmax({0}, {1})",
    },
    declared="const double {0} = {1};",
    logical="const int {0} = {1};",
    truth=("0", "1"),
)
_HEADER = """\
/* Simulation of @SOURCE@: C99 without dependencies.
 *
 *     @NAME@_model m;
 *     @NAME@_inputs u = {0};
 *     @NAME@_outputs y;
 *     @NAME@_defaults(&m);
 *     m.J = 0.3;                       parameters, before the start
 *     @NAME@_start(&m, 0.0, 0.0);      angle and speed
 *     u.current = 2.0;
 *     @NAME@_step(&m, 0.001, &u, &y);  one step of 1 ms
 *
 * SI units at the joint, after the gear; the motor's angle is before it.
@NOTES@ */

#ifndef @NAME@_H
#define @NAME@_H

#ifdef __cplusplus
extern "C" {
#endif

/* Ends of the 90 % intervals of the parameters. */
@INTERVALS@
/* Least and greatest values in the recordings; beyond them the model is an extrapolation. */
@RANGES@
/* Inputs; they are held over a step. */
typedef struct {
@INPUTS@} @NAME@_inputs;

typedef struct {
@OUTPUTS@} @NAME@_outputs;

typedef struct {
@MEMORIES@} @NAME@_memory;

typedef struct {
@PARAMETERS@    double largest_step; /* s; a longer step is divided */
    /* State of the simulation. */
    double derived[@DERIVED@];
    @NAME@_memory memory;
    double angle, velocity, sense;
    int first;
} @NAME@_model;

/* Set the parameters that were identified. */
void @NAME@_defaults(@NAME@_model *m);

/* Start a simulation or an inverse computation; to be called after a change of parameters. */
void @NAME@_start(@NAME@_model *m, double angle, double velocity);

/* Advance by dt seconds. Set-valued friction holds the joint exactly still.
 * Return 0, or -1 if dt is not positive or no speed solves the equations. */
int @NAME@_step(@NAME@_model *m, double dt, const @NAME@_inputs *u, @NAME@_outputs *y);

/* Return the outputs for a motion that is given sample by sample in angle, velocity and
 * acceleration of y: required - load_torque is the torque that the drive must produce. */
void @NAME@_inverse(@NAME@_model *m, double dt, const @NAME@_inputs *u, @NAME@_outputs *y);

#ifdef __cplusplus
}
#endif

#endif
"""
_SOURCE = """\
#include "@NAME@.h"

#include <math.h>

/* One sample: inputs, motion, and the time since the previous sample. */
typedef struct {
    double current, contact_force, load_torque, weight_mass;
    double angle, velocity, acceleration, sense, step;
    int first;
} sample;

static inline double sign(double a) { return (double)((a > 0.0) - (a < 0.0)); }

static inline double power(double a, double b) { return b == 2.0 ? a * a : pow(a, b); }

static void derive(@NAME@_model *m)
{
    (void)sign, (void)power;
@DERIVE@}

/* Required torque less the torque of drive and loads. */
static double residual(const @NAME@_model *m, const sample *x)
{
@RESIDUAL@}

/* All outputs, and the memory after this sample. */
static void keep(@NAME@_model *m, const sample *x, @NAME@_outputs *y)
{
    @NAME@_memory next;
@EVALUATE@    y->angle = m->angle = x->angle;
    y->velocity = m->velocity = x->velocity;
    y->acceleration = x->acceleration;
    y->sense = x->sense;
    m->memory = next;
    m->first = 0;
}

static void move(const @NAME@_model *m, sample *x, double speed, double sense)
{
    x->velocity = speed;
    x->acceleration = (speed - m->velocity) / x->step;
    x->angle = m->angle + 0.5 * x->step * (speed + m->velocity);
    x->sense = sense;
}

/* Torque that is missing for a speed at the end of the step. */
static double trial(const @NAME@_model *m, sample *x, double speed, double sense)
{
    move(m, x, speed, sense);
    return residual(m, x);
}

/* One step, in which friction holds the joint or the speed has one sign. */
static int advance(@NAME@_model *m, sample *x, @NAME@_outputs *y)
{
    const double up = trial(m, x, 0.0, 1.0);
    const double down = up < 0.0 ? up : trial(m, x, 0.0, -1.0);
    const double side = up < 0.0 ? 1.0 : -1.0;
    double low = 0.0, high = INFINITY, last = 0.0, before = -fabs(up < 0.0 ? up : down);
    double speed = m->velocity != 0.0 ? fabs(m->velocity) : 1e-6, value = 0.0, next = 0.0;
    int k;
    if (up >= 0.0 && down <= 0.0) {
        move(m, x, 0.0, up > down ? -(up + down) / (up - down) : 0.0);
        keep(m, x, y);
        return 0;
    }
    for (k = 0; k < 200; k++) {
        value = side * trial(m, x, side * speed, side);
        if (value < 0.0)
            low = speed;
        else
            high = speed;
        next = speed - value * (speed - last) / (value - before);
        if (value == 0.0 || fabs(next - speed) <= 1e-12 * speed + 1e-18)
            break;
        if (!(low < next && next < high) || (k % 10 == 9 && high < INFINITY))
            next = high < INFINITY ? 0.5 * (low + high) : 2.0 * speed;
        if (high - low <= 1e-13 * speed)
            break;
        last = speed;
        before = value;
        speed = next;
    }
    if (!isfinite(value))
        return -1;
    if (value == 0.0)
        next = speed;
    else if (fabs(value) > 1e-6 * fabs(up < 0.0 ? up : down))
        next = low; /* the torque jumps, as where a gap closes */
    move(m, x, side * next, side);
    keep(m, x, y);
    return 0;
}

void @NAME@_defaults(@NAME@_model *m)
{
@DEFAULTS@    m->largest_step = @STEP@;
    @NAME@_start(m, 0.0, 0.0);
}

void @NAME@_start(@NAME@_model *m, double angle, double velocity)
{
    const @NAME@_memory empty = {0};
    derive(m);
    m->memory = empty;
    m->angle = angle;
    m->velocity = velocity;
    m->sense = sign(velocity);
    m->first = 1;
}

static sample sampled(const @NAME@_model *m, const @NAME@_inputs *u)
{
    sample x = {0};
    x.current = u->current;
    x.contact_force = u->contact_force;
    x.load_torque = u->load_torque;
    x.weight_mass = u->weight_mass;
    x.angle = m->angle;
    x.velocity = m->velocity;
    x.sense = m->sense;
    x.first = m->first;
    x.step = m->largest_step;
    return x;
}

int @NAME@_step(@NAME@_model *m, double dt, const @NAME@_inputs *u, @NAME@_outputs *y)
{
    const double count = fmax(ceil(dt / m->largest_step - 1e-9), 1.0);
    sample x = sampled(m, u);
    double k;
    if (!(dt > 0.0))
        return -1;
    if (m->first)
        keep(m, &x, y);
    x.first = 0;
    x.step = dt / count;
    for (k = 0.0; k < count; k += 1.0)
        if (advance(m, &x, y))
            return -1;
    return 0;
}

void @NAME@_inverse(@NAME@_model *m, double dt, const @NAME@_inputs *u, @NAME@_outputs *y)
{
    sample x = sampled(m, u);
    x.step = dt;
    x.angle = y->angle;
    x.velocity = y->velocity;
    x.acceleration = y->acceleration;
    if (x.velocity != 0.0 || m->first)
        m->sense = sign(x.velocity);
    x.sense = m->sense;
    keep(m, &x, y);
}
"""
TEST = """\
/* Compares the model with the expected output of the test files:
 * cc -std=c99 -O2 @NAME@.c test.c -lm -o test && ./test */

#include "@NAME@.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { COLUMNS = 13, LAST = 8 };

static double run(const char *file, int inverse)
{
    static const char *names[] = {"angle", "velocity", "acceleration", "sense", "required",
                                  "drive", "motor_angle", "voltage"};
    static double most[LAST], error[LAST], time, worst;
    char line[1024];
    @NAME@_model m;
    FILE *stream = fopen(file, "r");
    int k, first = 1;
    if (!stream || !fgets(line, sizeof line, stream)) {
        printf("%s: cannot be read\\n", file);
        return INFINITY;
    }
    @NAME@_defaults(&m);
    memset(most, 0, sizeof most), memset(error, 0, sizeof error);
    time = worst = 0.0;
    while (fgets(line, sizeof line, stream)) {
        double c[COLUMNS], y[LAST];
        @NAME@_inputs u;
        @NAME@_outputs out;
        char *place = line;
        for (k = 0; k < COLUMNS; k++) {
            int used = 0;
            if (sscanf(place, "%lf%n", &c[k], &used) != 1)
                return INFINITY;
            place += used + (place[used] == ',');
        }
        u.current = c[1], u.contact_force = c[2], u.load_torque = c[3], u.weight_mass = c[4];
        out.angle = c[5], out.velocity = c[6], out.acceleration = c[7];
        if (first)
            @NAME@_start(&m, c[5], c[6]);
        if (inverse)
            @NAME@_inverse(&m, first ? m.largest_step : c[0] - time, &u, &out);
        else if (!first && @NAME@_step(&m, c[0] - time, &u, &out))
            return INFINITY;
        time = c[0];
        y[0] = out.angle, y[1] = out.velocity, y[2] = out.acceleration, y[3] = out.sense;
        y[4] = out.required, y[5] = out.drive, y[6] = out.motor_angle, y[7] = out.voltage;
        for (k = 0; k < LAST && (inverse || !first); k++) {
            most[k] = fmax(most[k], fabs(c[5 + k]));
            error[k] = fmax(error[k], fabs(y[k] - c[5 + k]));
            if (!(error[k] < INFINITY))
                return INFINITY;
        }
        first = 0;
    }
    fclose(stream);
    for (k = 0; k < LAST; k++) {
        const double relative = error[k] / fmax(most[k], 1e-12);
        printf("%s %s %.3g\\n", file, names[k], relative);
        if (inverse ? k >= 4 : k != 2 && k != 3)
            worst = fmax(worst, relative);
    }
    return worst;
}

int main(void)
{
    const double motion = run("test_motion.csv", 1), simulation = run("test_simulation.csv", 0);
    return motion <= 1e-6 && simulation <= 1e-6 ? 0 : 1;
}
"""
_S_FUNCTION = """\
/* Level-2 S-function of @NAME@ for Simulink: mex @NAME@_sfun.c @NAME@.c
 *
 * Dialog parameter: sample time, s. Input port: @INPUTS@.
 * Output port: @OUTPUTS@.
 */

#define S_FUNCTION_NAME @NAME@_sfun
#define S_FUNCTION_LEVEL 2

#include <stdlib.h>

#include "@NAME@.h"
#include "simstruc.h"

static void mdlInitializeSizes(SimStruct *S)
{
    ssSetNumSFcnParams(S, 1);
    if (ssGetNumSFcnParams(S) != ssGetSFcnParamsCount(S))
        return;
    if (!ssSetNumInputPorts(S, 1) || !ssSetNumOutputPorts(S, 1))
        return;
    ssSetInputPortWidth(S, 0, @INPUT_COUNT@);
    ssSetInputPortRequiredContiguous(S, 0, 1);
    ssSetInputPortDirectFeedThrough(S, 0, 0);
    ssSetOutputPortWidth(S, 0, @OUTPUT_COUNT@);
    ssSetNumSampleTimes(S, 1);
    ssSetNumPWork(S, 2);
}

static void mdlInitializeSampleTimes(SimStruct *S)
{
    ssSetSampleTime(S, 0, mxGetScalar(ssGetSFcnParam(S, 0)));
    ssSetOffsetTime(S, 0, 0.0);
}

#define MDL_START
static void mdlStart(SimStruct *S)
{
    @NAME@_model *m = calloc(1, sizeof *m);
    @NAME@_outputs *y = calloc(1, sizeof *y);
    ssSetPWorkValue(S, 0, m);
    ssSetPWorkValue(S, 1, y);
    if (m && y)
        @NAME@_defaults(m);
    else
        ssSetErrorStatus(S, "@NAME@: no memory");
}

static void mdlOutputs(SimStruct *S, int_T tid)
{
    const @NAME@_outputs *y = ssGetPWorkValue(S, 1);
    real_T *out = ssGetOutputPortRealSignal(S, 0);
    (void)tid;
@COPIES@}

#define MDL_UPDATE
static void mdlUpdate(SimStruct *S, int_T tid)
{
    const real_T *in = ssGetInputPortRealSignal(S, 0);
    @NAME@_inputs u;
    (void)tid;
@READS@    if (@NAME@_step(ssGetPWorkValue(S, 0), mxGetScalar(ssGetSFcnParam(S, 0)), &u,
                    ssGetPWorkValue(S, 1)))
        ssSetErrorStatus(S, "@NAME@: no speed solves the equations; are the inputs finite?");
}

static void mdlTerminate(SimStruct *S)
{
    free(ssGetPWorkValue(S, 0));
    free(ssGetPWorkValue(S, 1));
}

#ifdef MATLAB_MEX_FILE
#include "simulink.c"
#else
#include "cg_sfun.h"
#endif
"""
EVERY = {**SIGNALS, **OUTPUTS}
"""All outputs of a simulation, in the order of the structure and of the test files."""


def filled(template: str, machine: Machine, **texts: str) -> str:
    """Return a template with the name of the machine and other texts in their places."""
    for key, text in {"NAME": machine.name, **texts}.items():
        template = template.replace(f"@{key}@", text)
    return template


def notes(machine: Machine, lead: str) -> str:
    """Return what the simulation lacks as lines of a comment."""
    lines = [f"Not in the simulation: {left.words}." for left in machine.left_out]
    return "".join(f"{lead}{line}\n" for line in lines)


def c_texts(machine: Machine) -> dict[str, str]:
    """Return header, source and test program by their file names."""
    outputs, updates = roots_of(machine)
    constants = derived([machine.residual, *outputs, *updates])
    members = {n: k for k, n in machine.memories.items()}

    def known(each: Node) -> str | None:
        if each.operation == "parameter":
            return f"m->{each.name}"
        if each.operation == "input":
            return f"x->{each.name}"
        return f"m->memory.{members[each]}" if each.operation == "memory" else None

    def quick(each: Node) -> str | None:
        return f"m->derived[{constants.index(each)}]" if each in places else known(each)

    places = set(constants)
    lines, values = statements(constants, known, C)
    derive = [*lines, *(f"m->derived[{k}] = {v};" for k, v in enumerate(values))]
    lines, (rest,) = statements([machine.residual], quick, C)
    more, found = statements([*outputs, *updates], quick, C)
    names = [f"y->{n}" for n in machine.outputs] + [f"next.{n}" for n in machine.memories]
    evaluate = [*more, *(f"{n} = {v};" for n, v in zip(names, found, strict=True))]
    limits = [
        (f"{q.name}_{end}", value, q.unit)
        for q in machine.parameters
        for end, value in (("LOW", q.low), ("HIGH", q.high))
        if value is not None
    ]
    ranges = [
        (f"{n}_{end}", value, machine.unit_of(n) if n in {**EVERY, **INPUTS} else "")
        for n, ends in machine.ranges.items()
        for end, value in zip(("LEAST", "GREATEST"), ends, strict=True)
    ]
    parameters = [(q.name, q.unit + q.interval) for q in machine.parameters]
    return {
        f"{machine.name}.h": filled(
            _HEADER,
            machine,
            SOURCE=machine.source,
            NOTES=notes(machine, " * "),
            INTERVALS=_macros(machine, limits),
            RANGES=_macros(machine, ranges),
            INPUTS=_members(machine, INPUTS),
            OUTPUTS=_members(machine, EVERY),
            MEMORIES=_lines([f"double {n};" for n in machine.memories] or ["double none;"]),
            PARAMETERS=_lines([f"double {n}; /* {words} */" for n, words in parameters]),
            DERIVED=str(max(len(constants), 1)),
        ),
        f"{machine.name}.c": filled(
            _SOURCE,
            machine,
            DERIVE=_lines(derive or ["m->derived[0] = 0.0;"]),
            RESIDUAL=_lines([*lines, f"return {rest};"]),
            EVALUATE=_lines(evaluate if machine.memories else [*evaluate, "next.none = 0.0;"]),
            DEFAULTS=_lines([f"m->{q.name} = {q.value!r};" for q in machine.parameters]),
            STEP=repr(machine.largest_step),
        ),
        "test.c": filled(TEST, machine),
    }


def s_function_text(machine: Machine) -> str:
    """Return the S-function around the C of the machine."""
    return filled(
        _S_FUNCTION,
        machine,
        INPUTS=", ".join(f"{n} ({machine.unit_of(n)})" for n in INPUTS),
        OUTPUTS=", ".join(f"{n} ({machine.unit_of(n)})" for n in EVERY),
        INPUT_COUNT=str(len(INPUTS)),
        OUTPUT_COUNT=str(len(EVERY)),
        COPIES=_lines([f"out[{k}] = y->{n};" for k, n in enumerate(EVERY)]),
        READS=_lines([f"u.{n} = in[{k}];" for k, n in enumerate(INPUTS)]),
    )


def _lines(lines: Sequence[str]) -> str:
    return "".join(f"    {line}\n" for line in lines)


def _members(machine: Machine, signals: Mapping[str, tuple[str, str]]) -> str:
    return _lines([f"double {n}; /* {machine.unit_of(n)}: {w} */" for n, (_, w) in signals.items()])


def _macros(machine: Machine, values: Sequence[tuple[str, float, str]]) -> str:
    lead = machine.name.upper()
    return "".join(
        f"#define {lead}_{name.upper()} {number(value)} /* {unit} */\n"
        for name, value, unit in values
    )
