"""No velocity that varies within a profile leads out of what encloses its paths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.motion.varying import integrate, signs
from viatool.motion import profile as profiles
from viatool.motion.profile import VelocityProfile

FINE, RUNS = 24, 200
KINDS = ("differential", "sliding", "turning", "forth and back")


def random_profile(generator, kind, cells=12, stages=5):
    """Profiles of up to a second; some stages are empty, some boxes thin."""
    lengths = generator.uniform(0.0, 0.4, (cells, stages)) * generator.choice(
        [0.0, 1.0, 1.0], (cells, stages)
    )
    edges = np.concatenate([np.zeros((cells, 1)), np.cumsum(lengths, axis=1)], axis=1)
    scale = {"differential": (1.0, 0.05, 1.0), "sliding": (0.2, 1.0, 1.0), "turning": (1.0, 0.0, 6.0)}
    least = {"forth and back": -1.0}.get(kind, 0.2)
    size = np.array(scale.get(kind, (1.0, 0.3, 1.5)))
    middle = size * generator.uniform((least, -1.0, -1.0), 1.0, (cells, stages, 3))
    radius = (
        size * generator.uniform(0.0, 0.4, (cells, stages, 3)) * generator.choice([0.0, 1.0], (cells, 1, 3))
    )
    return VelocityProfile(edges, middle - radius, middle + radius)


def paths(generator, profile, cell):
    """Places and headings (R, N + 1) of admissible paths of one profile, and the instants (N + 1,)."""
    lengths = np.diff(profile.edges[cell])
    steps = np.repeat(lengths / FINE, FINE)
    middle = np.repeat(0.5 * (profile.lower + profile.upper)[cell], FINE, axis=0)
    radius = np.repeat(0.5 * (profile.upper - profile.lower)[cell], FINE, axis=0)
    found = integrate(np.zeros((RUNS, 3)), middle + radius * signs(generator, RUNS, len(steps)), steps)
    return found[..., 0] + 1j * found[..., 1], found[..., 2], np.concatenate([[0.0], np.cumsum(steps)])


def excess(kind, seeds):
    """By how much paths leave what encloses them: places (metres), headings (radians) and placed outlines (metres)."""
    worst = np.full(3, -np.inf)
    for seed in seeds:
        generator = np.random.default_rng(seed)
        profile = random_profile(generator, kind)
        whole = profile.edges[:, -1]
        start, end = np.sort(generator.uniform(0.0, 1.0, (2, len(profile))) * whole, axis=0)
        start, end = np.where(generator.random(len(whole)) < 0.3, 0.0, start), np.minimum(end, whole)
        spread = profile.spread(start, end)
        tail, head, beyond = spread.swath(profile.place(start)[0], profile.place(end)[0])
        at = 0.5 * (start + end)
        middle, faced = profile.place(at)
        moved, turned = np.maximum(profile.extent(start, at), profile.extent(at, end))
        for cell in range(len(profile)):
            places, headings, time = paths(generator, profile, cell)
            some = (time >= start[cell] - 1e-12) & (time <= end[cell] + 1e-12)
            if not some.any():
                continue
            beside = distance(places[:, some], tail[cell], head[cell]).max()
            worst[0] = max(worst[0], beside - (beyond + spread.aside)[cell])
            apart = np.abs(headings[:, some] - faced[cell]).max()
            worst[1] = max(worst[1], apart - (spread.apart + turned)[cell])
            rest = np.abs(places[:, some] - middle[cell]).max()
            worst[2] = max(worst[2], rest - (spread.along + spread.aside + moved)[cell])
    return worst


def distance(points, start, end):
    """From points to a segment."""
    along = end - start
    share = np.clip(((points - start) * np.conj(along)).real / max(abs(along) ** 2, 1e-300), 0.0, 1.0)
    return np.abs(points - start - share * along)


@pytest.mark.parametrize("kind", KINDS)
def test_paths_stay_within_what_encloses_them(kind):
    assert (excess(kind, range(12)) <= 1e-4).all()


def without(*names):
    """What bounds other paths, with some of its parts taken for 0."""
    right = VelocityProfile.spread

    def spread(profile, start, end):
        found = right(profile, start, end)
        return replace(found, **{name: 0.0 * getattr(found, name) for name in names})

    return spread


MUTANTS = {
    "ahead": (VelocityProfile, "spread", without("along"), "forth and back"),
    "aside": (VelocityProfile, "spread", without("aside"), "differential"),
    "sliding": (VelocityProfile, "spread", without("along"), "sliding"),
    "headings": (VelocityProfile, "spread", without("apart"), "turning"),
    "before": (VelocityProfile, "spread", without("first"), "differential"),
    "sagitta": (profiles, "sagitta_of", lambda length, chord: 0.0 * length, "turning"),
    "swung": (
        profiles,
        "_headings",
        lambda radius, held: (right_headings(radius, held)[0], 0.0 * held),
        "differential",
    ),
}
right_headings = profiles._headings


@pytest.mark.parametrize("name", MUTANTS)
def test_paths_leave_a_bound_without_one_of_its_parts(monkeypatch, name):
    place, part, mutant, kind = MUTANTS[name]
    monkeypatch.setattr(place, part, mutant)
    assert any((excess(kind, [seed]) > 1e-3).any() for seed in range(30))
