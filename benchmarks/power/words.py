"""Words of the page that do not depend on the figures."""

from __future__ import annotations

INTRODUCTION = """# What an experiment will show

Which effects will recordings show, and from which size? This page answers it before an experiment:
for every effect of the [catalogue](reference/effects.md), along the axes of an experiment that one
can choose. For recordings that exist, `rig diagnose SOURCE --observable` answers it directly.

`make power-map` makes this page. It draws {machines} machines as `rig prove --plant mujoco` draws
them (greatest torque 0.2 to 40 N m; {draws}), simulates each of them
without any effect in a base world, and then changes one axis at a time. From excitation, channels
and noise follows the **least size** of each effect that the recordings can show: the size whose
trace, after a new fit of the nominal parameters, is significant at 1 % over all effects, and not
below a hundredth of the noise's power. Sizes are relative to the **injected size**: the middle one
of the sizes that the proofs inject into the same machine, from near the noise to obvious.

![Power map](images/{picture})

How to read the picture: find the row of the effect and the columns of your experiment. A blue cell
of 3 means that the recordings show an effect of 3 % of the injected size. Where several axes differ
from the base world (bold), multiply: the base value by the ratio of each cell to the base value. A
grey cell means that the recordings cannot show the effect at any size, in most of the machines.
Figures in the tables below are medians, with the quartiles over the machines in brackets.

Limits of the map:

- Least sizes are those of one effect alone, with known noise. A diagnosis has to search, and to
  tell the effect from its rivals; the next section compares the two.
- Of effects with an asterisk in the table of the base world only a few trial sizes are tested; the
  least size is one of these. It may be too large by the step between them, and "not shown" may mean
  that the trial sizes are too small.
- The recordings are short, four of 8 s, so that the map is cautious for long experiments: with the
  same motion the least size falls with the square root of the time.
- Gas generators are not in the map.
"""

RULE = """From {times:g} times the least size on, {far} were named first and {alias} in the alias
group; between the least size and {times:g} times it, {near} were named first. **Visible is not yet
named: read {times:g} times the least size as what a diagnosis will name.** In the picture those
are the cells below 10 %, for an effect of the injected size. The rigs are few, and the threshold
was chosen on them, so that these shares are rough. The product over the axes is coarse too: the
map's figure is within a factor of three of the recordings' own for {close} rigs, and at worst off
by a factor of {worst}, where an effect is at the edge of being shown at all."""

CHECKED = """{rigs} rigs with one effect each were drawn anew on MuJoCo's plant, all axes at once,
and diagnosed blind. An effect is *visible* if its size is at least the least one: by the rig's own
recordings, from the simulation of the same rig without its effect; and by the map, from the axes of
the rig alone."""

WORST = """## The ten worst axes

The ten pairs of effect and axis over which the least size varies most, without those of which one
end is not shown at all, and what lies behind such pairs:

- *Steps.* The joint stands still most of the time: of four recordings of 8 s one machine had 28
  independent rows of torque in motion, against 1143 with sines. What acts in motion needs motion.
- *12 bits.* One count is 1.5 mrad. Effects in the difference of two encoders (compliance, mesh,
  slip, eccentricity) are measured in counts.
- *One encoder.* There is no equation of the transmission, so that effects between motor and joint
  are not seen at all, except for their torque.
- *100 Hz.* The voltage's equation needs the derivative of the current; on one machine the noise of
  its rows was 12 mV at 100 Hz, 1.4 mV at 1000 Hz and 0.3 mV at 4000 Hz.
- *Rests.* A breakaway counts with the torque's uncertainty within one sample. On one machine the
  noise of a breakaway was 0.09 N m at 100 Hz and 0.7 N m at 1000 Hz, half of the Coulomb friction,
  and at 4000 Hz there was no equation of breakaways. So `dwell_static_friction` is not shown at the
  sizes that the proofs inject, at any rate. That is a limit of the program more than of the
  recordings.
- *Loads.* Effects of the load's friction are seen from the difference of two weights and none.
"""
