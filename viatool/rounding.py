"""How floating-point numbers round, and every allowance for it, each named once with the reason why it suffices.

Two programs round: viatool itself, in float64, and the policy on the robot, in the precision of each of its nodes. What
viatool allows for itself is generous by some powers of two, since a bound that is 1e-12 wider proves as much.
"""

from __future__ import annotations

UNIT_ROUNDOFF = {"bfloat16": 2.0**-8, "float16": 2.0**-11, "float32": 2.0**-24, "float64": 2.0**-53}
"""Largest relative error of one rounding to the nearest number, for normal results."""

SMALLEST_NORMAL = {"bfloat16": 2.0**-126, "float16": 2.0**-14, "float32": 2.0**-126, "float64": 2.0**-1022}
"""Largest absolute error of one rounding below it, even where a program flushes what is smaller to 0."""

LARGEST = {"bfloat16": 3.3e38, "float16": 65504.0, "float32": 3.4e38, "float64": 1.7e308}
"""No result of at most this size overflows."""

ENGINE_ROUNDOFF = UNIT_ROUNDOFF["float64"]

LAST_PLACE = 2.0 * ENGINE_ROUNDOFF
"""The unit in the last place of 1, and of every float64 at most this share of the number."""

SLIGHTLY = 2.0**-40
SLIGHTLY_MORE = 1.0 + SLIGHTLY
"""Factor that covers the rounding of the few float64 operations with which a bound of numbers >= 0 is computed.

A sum of n numbers that are not negative errs by at most n roundings of 2^-53, so this covers 2^13 of them.
"""

SPARE = 2.0**-44
"""What covers a few roundings of numbers of size 1 or less (metres within a cell, a sine, a cosine): 2^9 of them."""

DISTANCE_ROUNDING = 2.0**-38
"""Metres for each metre of scale that cover the rounding of a clearance.

It is the result of fewer than 2^10 float64 operations on numbers below the scale; this is 2^15 roundings of it, or
1e-10 m on a map of some metres.
"""

CLOCK_ROUNDING = 2.0**-23
"""Seconds for each second of a path that cover the rounding of when a robot that brakes is somewhere on it.

The root of what is left of the path takes a rounding of 2^-49 to 2^-24.5.
"""

SIGHT_ROUNDING = 2.0**-36
"""Metres for each metre of scale (extent of map, pose and range) that cover the rounding of what is seen from a set.

A distance, a bearing or a range is the result of fewer than 2^10 float64 operations, each of which errs by at most
2^-53 of a number below the scale, and no error is amplified by more than the 2^6 that `sight` allows slopes to be.
"""

AS_RECEIVED = 2.0**-22
"""Share of an observation that its rounding to float32 and that of the ray casting may take from eps.

The first takes at most 2^-24 of it; the second, in float64, far less than the rest.
"""

FEW_ROUNDINGS = 2.0**-21
"""Relative to the sizes of the terms: more than an encoding that is evaluated in float32 strays, in whatever form."""
