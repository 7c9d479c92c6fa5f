"""What numbers, points and mappings of a map file may be.

Lengths are metres, angles are radians counter-clockwise, speeds m/s and rad/s, poses x, y, theta.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import ErrorDetails, PydanticCustomError


def _refuse_truth(value: Any) -> Any:
    """Refuse true and false (in YAML also yes, no, on, off) where a number is expected."""
    if isinstance(value, bool):
        raise ValueError("expected a number, got a truth value")
    return value


def _refuse_far(value: float) -> float:
    """Refuse more than a thousand kilometres: it is a slip, and squares of it lose digits."""
    if abs(value) > 1e6:
        raise ValueError("expected a size of at most 1e6")
    return value


def _refuse_far_unless_infinite(value: float) -> float:
    """Refuse what is no number and no limit; infinity, in YAML .inf, says that there is none."""
    if math.isnan(value):
        raise ValueError("expected a number, or .inf for no limit")
    return value if math.isinf(value) else _refuse_far(value)


Number = Annotated[
    float, BeforeValidator(_refuse_truth), AfterValidator(_refuse_far), Field(allow_inf_nan=False)
]
Unlimited = Annotated[float, BeforeValidator(_refuse_truth), AfterValidator(_refuse_far_unless_infinite)]
UnlimitedPositive = Annotated[Unlimited, Field(gt=0.0)]
Positive = Annotated[Number, Field(gt=0.0)]
NotNegative = Annotated[Number, Field(ge=0.0)]
Point = tuple[Number, Number]
Pose = tuple[Number, Number, Number]
Size = tuple[Positive, Positive]


class Strict(BaseModel):
    """A typed model that takes no key which it does not know, and does not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def misplaced(message: str, *place: str | int) -> PydanticCustomError:
    """Return the error of a whole mapping, and at which of its keys it is to be shown."""
    return PydanticCustomError("value_error", "{message}", {"message": message, "place": place})


def place_of(finding: ErrorDetails) -> tuple[str | int, ...]:
    """Return the key that something found by pydantic is about."""
    return (*finding["loc"], *finding.get("ctx", {}).get("place", ()))
