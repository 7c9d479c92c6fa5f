"""The exception tree: every error a user can meet says what, where, what was expected, and one way to mend it."""

from __future__ import annotations


class ViatoolError(Exception):
    """Base of every error that viatool raises on purpose.

    Parameters
    ----------
    message : str
        Names the thing, its value and what was expected.
    hint : str, optional
        One imperative sentence that tells how to mend it.
    """

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.message}\nhint: {self.hint}" if self.hint else self.message


class InputError(ViatoolError):
    """Something that the user gave cannot be read, is not supported or contradicts itself."""


class PolicyError(InputError):
    """A policy file or its specification is unreadable, unsupported or inconsistent."""


class PolicyWarning(UserWarning):
    """A policy can be verified, but not all that a verdict rests on was checked."""


class MapError(InputError):
    """A map file is unreadable or describes an impossible world."""


class MapWarning(UserWarning):
    """A map can be read, but may not mean what its author thinks."""


class TrajectoryError(InputError):
    """A trajectory file is unreadable or does not fit the policy."""


class ConfigurationError(InputError):
    """An option or a configuration value is out of its range."""


class EnclosureError(InputError):
    """No finite enclosure exists, for example a reciprocal over a range that contains zero."""


class EmptyEvaluationError(ViatoolError):
    """Nothing was left to evaluate, so neither a rate nor a verdict exists."""


class SelfCheckError(ViatoolError):
    """The loaded network and onnxruntime disagree: no verdict may rest on this import."""


class BoundsError(ViatoolError):
    """Bounds are NaN or the wrong way round: an error of this program, on which no verdict may rest."""

    def __init__(
        self,
        message: str,
        hint: str = "set VIATOOL_TRACEBACK=1, run again and report the traceback as a bug",
    ) -> None:
        super().__init__(message, hint)


class WorkError(ViatoolError):
    """Work could not be carried out, whatever it was about: a worker died, or the cluster was lost."""
