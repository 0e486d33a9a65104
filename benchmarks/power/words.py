"""Words of the page that do not depend on the figures."""

from __future__ import annotations

INTRODUCTION = """# What an experiment will show

This page states, before an experiment is made, which effects its recordings will show, and from
which size: for every effect of the [catalogue](reference/effects.md), along those axes of an
experiment that the user can choose. For existing recordings, `rig diagnose SOURCE --observable`
states which effects they show.

`make power-map` makes this page. It draws {machines} machines as `rig prove --plant mujoco` draws
them (greatest torque 0.2 to 40 N m; {draws}), simulates each
machine without any effect in a base world, and then changes one axis at a time. The **least size**
of an effect that the recordings can show follows from excitation, channels and noise. At the least
size, the change that the effect makes after a new fit of the nominal parameters is significant at
1 % over all effects, and its power is at least a hundredth of that of the noise. Sizes are relative
to the **injected size**: the middle one of the sizes that the proofs inject into such a machine,
from near the noise to obvious.

![Power map](images/{picture})

To read the picture, find the row of the effect and the columns of your experiment. A blue cell with
the number 3 means that the recordings show an effect of 3 % of the injected size. If several axes
differ from the base world (bold), multiply the base value by the ratio of each cell to the base
value. A grey cell means that on most of the machines the recordings cannot show the effect at any
size. The figures in the tables below are medians, with the quartiles over the machines in brackets.

The map has these limits:

- A least size is that of one effect alone, with known noise. A diagnosis has to search, and to
  distinguish the effect from its rivals; the next section compares map and diagnosis.
- Of effects with an asterisk in the table of the base world only a few trial sizes are tested; the
  least size is one of these trial sizes. The least size may be too large by the step between trial
  sizes, and "not shown" may mean that all trial sizes are too small.
- The simulated recordings are short, four of 8 s, so that the map is cautious for long experiments:
  with unchanged motion the least size falls with the square root of the time.
- Effects of gas generators are not in the map.
"""

RULE = """At {times:g} times the least size and more, {far} effects were named first and {alias}
in the alias group; between the least size and {times:g} times the least size, {near} were named
first. **An effect that is visible is not always named: a diagnosis names effects from {times:g}
times the least size on.** In the picture, the cells below 10 % are those in which an effect of
the injected size is that large. The rigs are few, and the factor of {times:g} was chosen on
them, so that these shares are rough. The product over the axes is approximate too: for {close}
rigs the least size of the map is within a factor of three of that by the rig's own recordings,
and at worst the two differ by a factor of {worst}, for an effect that hardly any recording
shows."""

CHECKED = """{rigs} rigs with one effect each were drawn on MuJoCo's plant, with random values
on all axes, and diagnosed blind. An effect is *visible* if its size is at least the least size.
The least size by the rig's own recordings follows from the simulation of the rig without its
effect; the least size by the map follows from the axes of the rig alone."""

WORST = """## The ten worst axes

The table has the ten pairs of effect and axis over which the least size varies most, without pairs
in which one end of the axis does not show the effect at all. These are the causes of such pairs:

- *Steps.* With steps as the excitation the joint rests most of the time: four recordings of 8 s of
  one machine had 28 independent rows of torque in motion, and 1143 with sines. Effects that act in
  motion need motion.
- *12 bits.* One count of a 12-bit encoder is 1.5 mrad. Effects in the difference of two encoders
  (compliance, mesh, slip, eccentricity) are resolved to a count.
- *One encoder.* With one encoder there is no transmission equation, so that effects between motor
  and joint show only in their torque.
- *100 Hz.* The voltage equation needs the derivative of the current; on one machine the noise of
  its rows was 12 mV at 100 Hz, 1.4 mV at 1000 Hz and 0.3 mV at 4000 Hz.
- *Rests.* A breakaway torque is uncertain by the change of the torque within one sample. On one
  machine the noise of a breakaway was 0.09 N m at 100 Hz and 0.7 N m at 1000 Hz, half of the
  Coulomb friction, and at 4000 Hz there was no breakaway equation. `dwell_static_friction` is
  therefore shown at no log rate at the sizes that the proofs inject. The least size of
  `dwell_static_friction` is limited by the program more than by the recordings.
- *Loads.* Effects of the load's friction show in the difference between recordings with two weights
  and with none.
"""
