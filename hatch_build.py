"""Build the compiled engine into the checkout and into wheels, where there is a compiler; without one, go on.

Run as a script, it builds in place: ``python hatch_build.py``.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

ENGINE = Path("viatool", "engine")
LIBRARY = "_kernel.dll" if sys.platform == "win32" else "_kernel.so"
FLAGS = (
    "-O3",
    "-std=gnu11",
    "-fPIC",
    "-shared",
    "-ffp-contract=off",
    "-fno-fast-math",
    "-fvisibility=hidden",
)
WAYS = (("-DVIATOOL_CLONES",), ())
"""With one version of the inner loops for each generation of processors, or with one for all."""


def digest_of(folder: Path) -> str:
    """Return what tells one state of the sources from another."""
    sources = sorted(path for path in folder.iterdir() if path.suffix in (".c", ".h"))
    return hashlib.sha256(b"".join(path.read_bytes().replace(b"\r\n", b"\n") for path in sources)).hexdigest()


def compile_kernel(root: Path) -> Path | None:
    """Compile the kernel beside its sources, whole or not at all; None where that is not possible or not wished."""
    folder = root / ENGINE
    if os.environ.get("VIATOOL_ENGINE") == "numpy":
        return None
    compilers = (
        os.environ.get("CC"),
        *(sysconfig.get_config_var("CC") or "").split()[:1],
        "cc",
        "gcc",
        "clang",
    )
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        built = Path(scratch, LIBRARY)
        for compiler in dict.fromkeys(filter(None, compilers)):
            for way in WAYS:
                if _runs([*compiler.split(), *FLAGS, *way, f'-DVIATOOL_DIGEST="{digest_of(folder)}"',
                          *map(str, sorted(folder.glob("*.c"))), "-o", str(built), "-lm"]):  # fmt: skip
                    return built.replace(folder / LIBRARY)
    return None


def _runs(command: list[str]) -> bool:
    try:
        return subprocess.run(command, capture_output=True, timeout=300).returncode == 0
    except (OSError, subprocess.SubprocessError):
        return False


try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # as a script, without the build backend
    BuildHookInterface = object


class KernelHook(BuildHookInterface):
    """Add the compiled engine to a wheel, which is then one for this platform and for every version of Python."""

    def initialize(self, version: str, build_data: dict) -> None:
        """Compile before the files of the wheel are gathered."""
        built = compile_kernel(Path(self.root))
        if built is None:
            self.app.display_warning("the compiled engine was not built: viatool runs its numpy engine")
            return
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"
        build_data["force_include"][str(built)] = (ENGINE / LIBRARY).as_posix()


if __name__ == "__main__":
    path = compile_kernel(Path(__file__).parent)
    print(path or "not built: no C compiler, or VIATOOL_ENGINE=numpy")
    sys.exit(path is None)
