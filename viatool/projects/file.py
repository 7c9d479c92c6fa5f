"""The project file: ``viatool.toml``, or the table ``[tool.viatool]`` of a ``pyproject.toml``, as a typed model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, model_validator
from typing_extensions import Self

from viatool.errors import ConfigurationError
from viatool.report import FORMATS, Acceptance
from viatool.toml_text import Place, TomlDocument, read_toml
from viatool.typed_toml import validated_toml

PROJECT = "viatool.toml"
PYPROJECT = "pyproject.toml"
TABLE: Place = ("tool", "viatool")

Options = Mapping[str, Any]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]*$", max_length=60)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class FileEntry(BaseModel):
    """A policy or a map, with options that belong to it, such as the `spec` of a policy; further keys are options."""

    model_config = ConfigDict(extra="allow", frozen=True)

    file: str = Field(min_length=1, description="the file, or the name of a sample")


Files = list[str] | dict[Name, str | FileEntry]


class CheckTable(BaseModel):
    """One question, asked of policies x maps x the axes of `matrix`; further keys are options of the command."""

    model_config = ConfigDict(extra="allow", frozen=True)

    name: Name | None = Field(
        default=None, description="how cells are called; by default the kind of the check"
    )
    kind: str = Field(default="verify", description="the command: verify, certify, mission, ...")
    policies: Files | None = Field(
        default=None, description="names of the project's, or files; by default all"
    )
    maps: Files | None = Field(default=None, description="names of the project's, or files; by default all")
    matrix: dict[str, Annotated[list[Any], Field(min_length=1)]] = Field(
        default={}, description="options with the values that each takes in turn"
    )
    gate: dict[str, Any] = Field(
        default={}, description="options of the gate, such as fail-under and max-unsafe"
    )
    include: list[dict[str, Any]] = Field(
        default=[],
        description="options for the cells that have the named policy, map and axes; a cell more where none has them",
    )
    exclude: list[dict[str, Any]] = Field(
        default=[], description="policy, map and axes of cells that are left out"
    )

    @property
    def title(self) -> str:
        """Return its name."""
        return self.name or self.kind


class ProjectFile(_Part):
    """A project: what is examined, on what, and what has to hold."""

    output: str = Field(default=".viatool", min_length=1, description="the folder of all that is written")
    reports: list[str] | None = Field(
        default=None,
        description="formats of the reports of each cell beside JSON; by default html, or markdown where html is not "
        "installed",
    )
    policies: Files = Field(
        default=[], description="a list of files or samples, or a table of names with their files"
    )
    maps: Files = Field(
        default=[], description="a list of files or samples, or a table of names with their files"
    )
    defaults: dict[str, Any] = Field(
        default={}, description="options, and a gate, of every check whose command has them"
    )
    check: list[CheckTable] = Field(min_length=1, description="what is asked")
    accepted: list[Acceptance] = Field(
        default=[], description="findings that somebody answers for, with a reason and an expiry date"
    )

    @model_validator(mode="after")
    def _has_names_of_its_own(self) -> Self:
        titles = [check.title for check in self.check]
        if twice := {title for title in titles if titles.count(title) > 1}:
            raise ValueError(f"two checks are called '{min(twice)}': give each a 'name'")
        if unknown := set(self.reports or ()) - FORMATS.keys():
            raise ValueError(f"reports: '{min(unknown)}' is no format, which are {', '.join(FORMATS)}")
        return self


@dataclass(frozen=True)
class Project:
    """A project file that was read.

    Parameters
    ----------
    document : TomlDocument
        The file, which knows its lines.
    below : tuple
        The keys below which the project stands in it.
    file : ProjectFile
        What it says.
    """

    document: TomlDocument
    below: Place
    file: ProjectFile

    @property
    def path(self) -> Path:
        """Return where the file is."""
        return self.document.path

    @property
    def root(self) -> Path:
        """Return the folder of the file, in which relative paths of it begin."""
        return self.path.absolute().parent

    def place(self, *location: str | int) -> str:
        """Return "file:line" of a field."""
        return self.document.place((*self.below, *location))

    def wrong(self, location: Place, what: str, hint: str) -> ConfigurationError:
        """Return an error that names file, line and field."""
        return ConfigurationError(f"{self.place(*location)}: {what}", hint)


def find_project(start: Path) -> Path:
    """Return the nearest project file in a folder or above it; ``viatool.toml`` goes before ``pyproject.toml``.

    Raises
    ------
    ConfigurationError
        If there is none.
    """
    for folder in (start.absolute(), *start.absolute().parents):
        if (path := folder / PROJECT).is_file():
            return _nearby(path)
        if (path := folder / PYPROJECT).is_file() and _table_of(read_toml(path)) is not None:
            return _nearby(path)
    raise ConfigurationError(
        f"there is no {PROJECT} in '{start}' or above it, and no {PYPROJECT} with [{'.'.join(map(str, TABLE))}]",
        "make one with viatool init, or name it with --project FILE",
    )


def load_project(path: Path) -> Project:
    """Read a project file.

    Raises
    ------
    ConfigurationError
        If it cannot be read or a field is wrong; names file, line and field.
    """
    document = read_toml(path)
    below = TABLE if path.name == PYPROJECT else ()
    if below and _table_of(document) is None:
        raise ConfigurationError(f"'{path}' has no table [tool.viatool]", "add it, or name another file")
    return Project(document, below, validated_toml(document, ProjectFile, below))


def _table_of(document: TomlDocument) -> Any:
    tool = document.content.get("tool")
    return tool.get("viatool") if isinstance(tool, dict) else None


def _nearby(path: Path) -> Path:
    """Return a path as short as it may be written here."""
    return Path(path.name) if path.parent == Path.cwd() else path
