"""The constraint methods on one TD3 backbone, one short file each, and their registry."""

from __future__ import annotations

from viatool.train.methods.cvar_cpo import CvarCpo
from viatool.train.methods.method import Method
from viatool.train.methods.rcpo import Rcpo
from viatool.train.methods.sac_lag import SacLagrangian
from viatool.train.methods.td3 import Td3
from viatool.train.methods.td7 import Td7
from viatool.train.methods.via import Via
from viatool.train.methods.wcsac import Wcsac

METHODS: dict[str, type[Method]] = {
    "td3": Td3,
    "td7": Td7,
    "rcpo": Rcpo,
    "sac-lag": SacLagrangian,
    "wcsac": Wcsac,
    "cvar-cpo": CvarCpo,
    "via": Via,
}

__all__ = ["METHODS", "Method"]
