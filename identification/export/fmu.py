"""The machine as the texts of an FMU for co-simulation, FMI 2 or 3: description, and C around the C
of the machine, without headers of others.
"""

from __future__ import annotations

import hashlib
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from identification.export.c import EVERY, c_texts, filled
from identification.export.machine import INPUTS, Machine

_SOURCE = """\
/* FMI @VERSION@ for co-simulation around @NAME@.c. */

#include "@NAME@.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined _WIN32
#define FMI __declspec(dllexport)
#else
#define FMI __attribute__((visibility("default")))
#endif

enum { OK = 0, FAILED = 3 };

#if @VERSION@ == 3
typedef void (*logger)(void *environment, int status, const char *category, const char *message);
typedef bool boolean;
#define NAMED(name) fmi3##name
#define STATE(verb) fmi3##verb##FMUState
#else
typedef void (*logger)(void *environment, const char *instance, int status, const char *category,
                       const char *message, ...);
typedef struct {
    logger log;
    void *allocate, *release, *finished, *environment;
} callbacks;
typedef int boolean;
#define NAMED(name) fmi2##name
#define STATE(verb) fmi2##verb##FMUstate
#endif

typedef struct {
    double time;
    @NAME@_inputs u;
    @NAME@_outputs y;
    double start_angle, start_velocity;
    @NAME@_model m;
} values;

typedef struct {
    values now;
    void *environment;
    logger log;
} component;

/* Places of the variables by their value references. */
static const size_t places[] = {
@PLACES@};

static int say(const component *c, const char *text)
{
    if (c->log)
#if @VERSION@ == 3
        c->log(c->environment, FAILED, "logStatusError", text);
#else
        c->log(c->environment, "@NAME@", FAILED, "logStatusError", text);
#endif
    return FAILED;
}

static double *place(component *c, uint32_t reference)
{
    if (reference >= sizeof places / sizeof places[0])
        return NULL;
    return (double *)(void *)((char *)&c->now + places[reference]);
}

static void *made(const char *token, void *environment, logger log)
{
    component *c;
    if (!token || strcmp(token, "@TOKEN@") != 0 || !(c = calloc(1, sizeof *c)))
        return NULL;
    c->environment = environment;
    c->log = log;
    @NAME@_defaults(&c->now.m);
    return c;
}

static int get(component *c, const uint32_t references[], size_t count, double out[])
{
    for (size_t k = 0; k < count; k++) {
        const double *found = place(c, references[k]);
        if (!found)
            return say(c, "no variable has this value reference");
        out[k] = *found;
    }
    return OK;
}

static int set(component *c, const uint32_t references[], size_t count, const double in[])
{
    for (size_t k = 0; k < count; k++) {
        double *found = place(c, references[k]);
        if (!found)
            return say(c, "no variable has this value reference");
        *found = in[k];
    }
    return OK;
}

static int begun(component *c)
{
    values *v = &c->now;
    @NAME@_model first;
    @NAME@_start(&v->m, v->start_angle, v->start_velocity);
    v->y.angle = v->start_angle;
    v->y.velocity = v->start_velocity;
    v->y.acceleration = 0.0;
    first = v->m; /* the first step takes the first sample into the memory */
    @NAME@_inverse(&first, first.largest_step, &v->u, &v->y);
    return OK;
}

static int stepped(component *c, double time, double step)
{
    if (@NAME@_step(&c->now.m, step, &c->now.u, &c->now.y))
        return say(c, "no speed solves the equations; are inputs and step finite?");
    c->now.time = time + step;
    return OK;
}

FMI int STATE(Get)(component *c, void **state)
{
    if (!*state && !(*state = malloc(sizeof(values))))
        return say(c, "no memory");
    memcpy(*state, &c->now, sizeof(values));
    return OK;
}

FMI int STATE(Set)(component *c, const void *state)
{
    memcpy(&c->now, state, sizeof(values));
    return OK;
}

FMI int STATE(Free)(component *c, void **state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return OK;
}

FMI int NAMED(SetDebugLogging)(component *c, boolean on, size_t count,
                               const char *const categories[])
{
    (void)c, (void)on, (void)count, (void)categories;
    return OK;
}

FMI int NAMED(Reset)(component *c)
{
    memset(&c->now, 0, sizeof(values));
    @NAME@_defaults(&c->now.m);
    return OK;
}

FMI void NAMED(FreeInstance)(component *c) { free(c); }
FMI int NAMED(Terminate)(component *c) { return c ? OK : FAILED; }
FMI int NAMED(ExitInitializationMode)(component *c) { return begun(c); }

#define ABSENT(name) \\
    FMI int NAMED(name)(component *c) { return say(c, "fmi@VERSION@" #name " is not supported"); }
#define OTHER_TYPE(type) ABSENT(Get##type) ABSENT(Set##type)

#if @VERSION@ == 3

#define NONE(name) \\
    FMI void *fmi3##name(void) { return NULL; }

FMI const char *fmi3GetVersion(void) { return "3.0"; }

FMI void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                      bool visible, bool logging, bool events, bool early,
                                      const uint32_t intermediate[], size_t count,
                                      void *environment, logger log, void *update)
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early;
    (void)intermediate, (void)count, (void)update;
    return made(token, environment, log);
}

FMI int fmi3EnterInitializationMode(component *c, bool tolerant, double tolerance, double start,
                                    bool ends, double stop)
{
    (void)tolerant, (void)tolerance, (void)ends, (void)stop;
    c->now.time = start;
    return begun(c);
}

FMI int fmi3GetFloat64(component *c, const uint32_t references[], size_t count, double out[],
                       size_t values_count)
{
    return values_count == count ? get(c, references, count, out) : FAILED;
}

FMI int fmi3SetFloat64(component *c, const uint32_t references[], size_t count, const double in[],
                       size_t values_count)
{
    return values_count == count ? set(c, references, count, in) : FAILED;
}

FMI int fmi3DoStep(component *c, double time, double step, bool no_return, bool *event, bool *end,
                   bool *early, double *last)
{
    const int status = stepped(c, time, step);
    (void)no_return;
    *event = *end = *early = false;
    *last = c->now.time;
    return status;
}

NONE(InstantiateModelExchange) NONE(InstantiateScheduledExecution) OTHER_TYPE(Float32)
OTHER_TYPE(Int8) OTHER_TYPE(UInt8) OTHER_TYPE(Int16) OTHER_TYPE(UInt16) OTHER_TYPE(Int32)
OTHER_TYPE(UInt32) OTHER_TYPE(Int64) OTHER_TYPE(UInt64) OTHER_TYPE(Boolean) OTHER_TYPE(String)
OTHER_TYPE(Binary) OTHER_TYPE(Clock) OTHER_TYPE(IntervalDecimal) OTHER_TYPE(IntervalFraction)
OTHER_TYPE(ShiftDecimal) OTHER_TYPE(ShiftFraction) ABSENT(ActivateModelPartition)
ABSENT(CompletedIntegratorStep) ABSENT(EnterConfigurationMode) ABSENT(EnterContinuousTimeMode)
ABSENT(EnterEventMode) ABSENT(EnterStepMode) ABSENT(EvaluateDiscreteStates)
ABSENT(ExitConfigurationMode) ABSENT(GetAdjointDerivative) ABSENT(GetContinuousStateDerivatives)
ABSENT(GetContinuousStates) ABSENT(GetDirectionalDerivative) ABSENT(GetEventIndicators)
ABSENT(GetNominalsOfContinuousStates) ABSENT(GetNumberOfContinuousStates)
ABSENT(GetNumberOfEventIndicators) ABSENT(GetNumberOfVariableDependencies)
ABSENT(GetOutputDerivatives) ABSENT(GetVariableDependencies) ABSENT(SetContinuousStates)
ABSENT(SetTime) ABSENT(UpdateDiscreteStates) ABSENT(SerializedFMUStateSize)
ABSENT(SerializeFMUState) ABSENT(DeserializeFMUState)

#else

FMI const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI const char *fmi2GetVersion(void) { return "2.0"; }

FMI void *fmi2Instantiate(const char *name, int type, const char *token, const char *resources,
                          const callbacks *called, boolean visible, boolean logging)
{
    (void)name, (void)resources, (void)visible, (void)logging;
    return type == 1 ? made(token, called->environment, called->log) : NULL;
}

FMI int fmi2SetupExperiment(component *c, boolean tolerant, double tolerance, double start,
                            boolean ends, double stop)
{
    (void)tolerant, (void)tolerance, (void)ends, (void)stop;
    c->now.time = start;
    return OK;
}

FMI int fmi2EnterInitializationMode(component *c) { return begun(c); }

FMI int fmi2GetReal(component *c, const uint32_t references[], size_t count, double out[])
{
    return get(c, references, count, out);
}

FMI int fmi2SetReal(component *c, const uint32_t references[], size_t count, const double in[])
{
    return set(c, references, count, in);
}

FMI int fmi2DoStep(component *c, double time, double step, boolean no_return)
{
    (void)no_return;
    return stepped(c, time, step);
}

OTHER_TYPE(Integer) OTHER_TYPE(Boolean) OTHER_TYPE(String) ABSENT(CancelStep)
ABSENT(DeSerializeFMUstate) ABSENT(GetBooleanStatus) ABSENT(GetDirectionalDerivative)
ABSENT(GetIntegerStatus) ABSENT(GetRealOutputDerivatives) ABSENT(GetRealStatus)
ABSENT(GetStatus) ABSENT(GetStringStatus) ABSENT(SerializeFMUstate)
ABSENT(SerializedFMUstateSize) ABSENT(SetRealInputDerivatives)

#endif
"""


class _Variable(NamedTuple):
    name: str
    place: str
    causality: str
    unit: str
    words: str
    start: float | None


def _variables(machine: Machine) -> list[_Variable]:
    """Return all variables in the order of their value references."""
    unit = machine.unit_of
    return [
        _Variable("time", "time", "independent", "s", "", None),
        *(_Variable(n, f"u.{n}", "input", unit(n), w, 0.0) for n, (_, w) in INPUTS.items()),
        *(_Variable(n, f"y.{n}", "output", unit(n), w, None) for n, (_, w) in EVERY.items()),
        _Variable(
            *("start_angle", "start_angle", "parameter", unit("angle")), "angle at the start", 0.0
        ),
        _Variable("start_velocity", "start_velocity", "parameter", unit("velocity"), "speed", 0.0),
        _Variable(
            *("largest_step", "m.largest_step", "parameter", "s"),
            "a longer step is divided",
            machine.largest_step,
        ),
        *(
            _Variable(q.name, f"m.{q.name}", "parameter", q.unit, q.unit + q.interval, q.value)
            for q in machine.parameters
        ),
    ]


def fmu_texts(machine: Machine, version: int) -> dict[str, str]:
    """Return all files of an FMU but its binary, by their places in it.

    Args:
        machine: The machine.
        version: 2 or 3.
    """
    c = {name: text for name, text in c_texts(machine).items() if name != "test.c"}
    digest = hashlib.sha256("".join(c.values()).encode()).hexdigest()
    token = f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"
    places = "".join(f"    offsetof(values, {v.place}),\n" for v in _variables(machine))
    source = filled(_SOURCE, machine, VERSION=str(version), TOKEN=token, PLACES=places)
    sources = {f"sources/{name}": text for name, text in {**c, "fmu.c": source}.items()}
    if version == 3:
        sources["sources/buildDescription.xml"] = _build_description(machine)
    return {"modelDescription.xml": _description(machine, version, token), **sources}


def _build_description(machine: Machine) -> str:
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<fmiBuildDescription fmiVersion="3.0">\n'
        f'  <BuildConfiguration modelIdentifier="{machine.name}">\n'
        '    <SourceFileSet language="C99">\n'
        f'      <SourceFile name="{machine.name}.c"/>\n      <SourceFile name="fmu.c"/>\n'
        "    </SourceFileSet>\n"
        "  </BuildConfiguration>\n</fmiBuildDescription>\n"
    )


def _description(machine: Machine, version: int, token: str) -> str:
    variables = _variables(machine)
    units = sorted({v.unit for v in variables})
    named = "guid" if version == 2 else "instantiationToken"
    state = "FMUstate" if version == 2 else "FMUState"
    files = "".join(f'<File name="{n}"/>' for n in (f"{machine.name}.c", "fmu.c"))
    step = 4.0 * machine.largest_step
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="{version}.0" modelName="{machine.name}"',
        f'  {named}="{token}" generationTool="loadrig"',
        f"  description={quoteattr(machine.source)}>",
        f'  <CoSimulation modelIdentifier="{machine.name}" canGetAndSet{state}="true"',
        '    canHandleVariableCommunicationStepSize="true"'
        + (f"><SourceFiles>{files}</SourceFiles></CoSimulation>" if version == 2 else "/>"),
        "  <UnitDefinitions>",
        *(f"    <Unit name={quoteattr(unit)}/>" for unit in units),
        "  </UnitDefinitions>",
        f'  <DefaultExperiment startTime="0" stopTime="1" stepSize="{step:g}"/>',
        "  <ModelVariables>",
    ]
    outputs = [k for k, v in enumerate(variables) if v.causality == "output"]
    for k, v in enumerate(variables):
        fixed = v.causality == "parameter"
        head = f'name="{v.name}" valueReference="{k}" causality="{v.causality}"'
        head += f' variability="{"fixed" if fixed else "continuous"}"'
        words = f" description={quoteattr(v.words)}" if v.words else ""
        start = "" if v.start is None else f' start="{v.start!r}"'
        unit = f" unit={quoteattr(v.unit)}"
        if version == 3:
            lines.append(f"    <Float64 {head}{words}{unit}{start}/>")
        else:
            lines.append(f"    <ScalarVariable {head}{words}><Real{unit}{start}/></ScalarVariable>")
    lines += ["  </ModelVariables>", "  <ModelStructure>"]
    if version == 3:
        lines += [f'    <Output valueReference="{k}"/>' for k in outputs]
        lines += [f'    <InitialUnknown valueReference="{k}"/>' for k in outputs]
    else:
        unknowns = "".join(f'<Unknown index="{k + 1}"/>' for k in outputs)
        lines += [f"    <{n}>{unknowns}</{n}>" for n in ("Outputs", "InitialUnknowns")]
    return "\n".join([*lines, "  </ModelStructure>", "</fmiModelDescription>"]) + "\n"
