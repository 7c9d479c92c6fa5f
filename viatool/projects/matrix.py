"""The matrix of a project: every check x policy x map x axis is a cell, which is one command line."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import PurePath
from typing import Any

import click

from viatool.errors import ConfigurationError
from viatool.projects.file import CheckTable, FileEntry, Files, Options, Project
from viatool.projects.folder import standing_in
from viatool.projects.options import Catalogue, arguments_of, seen_from, spelled
from viatool.report import Acceptance

_PLACES = ("policy", "map")


@dataclass(frozen=True)
class ProjectCell:
    """One run: a check of one policy on one map.

    Parameters
    ----------
    name : str
        Such as ``drive/via/lab`` or ``drive/via/lab/criterion=braking``.
    check, kind : str
        The check, and its command.
    policy, map : str
        As the project calls them.
    policy_file, map_file : str
        What the command is given.
    axes : mapping
        What this cell has of the check's axes.
    options : mapping
        All options of the command, by the names of the command line.
    accepted : tuple of Acceptance
        What is accepted of what is found in it.
    """

    name: str
    check: str
    kind: str
    policy: str
    map: str
    policy_file: str
    map_file: str
    axes: Options = field(default_factory=dict)
    options: Options = field(default_factory=dict)
    accepted: tuple[Acceptance, ...] = ()

    @property
    def folder(self) -> str:
        """Return the name of its folder."""
        return self.name.replace("/", "--")

    def arguments(self, catalogue: Catalogue) -> list[str]:
        """Return the words of its command line behind the name of the command, without outputs."""
        words = arguments_of(catalogue.command(self.kind), self.options)
        return [self.policy_file, f"--map={self.map_file}", *words]


def expand(
    project: Project, catalogue: Catalogue, overrides: Options | None = None
) -> tuple[ProjectCell, ...]:
    """Return the cells of a project.

    Parameters
    ----------
    project : Project
        What is asked.
    catalogue : Catalogue
        The commands, whose options hold what a cell may say.
    overrides : mapping
        Options that win over all that the file says, with paths that begin in the current folder; of an axis, they
        leave one value.

    Raises
    ------
    ConfigurationError
        If a key is unknown, a value is not one of its option, two cells have one name, or something is said of cells
        that do not exist; names file, line and field.
    """
    for number, check in enumerate(project.file.check):
        with _told_at(project, "check", number):
            catalogue.command(check.kind)
    _check_defaults(project, catalogue)
    catalogue.require([check.kind for check in project.file.check], overrides or {})
    won = seen_from(project.root, overrides or {}, catalogue)
    cells: list[ProjectCell] = []
    for number, check in enumerate(project.file.check):
        with _told_at(project, "check", number):
            cells += _Check(project, catalogue, check, won).cells()
    _refuse_same_names(project, cells)
    with standing_in(project.root):
        for number, check in enumerate(project.file.check):
            for cell in (cell for cell in cells if cell.check == check.title):
                with _told_at(project, "check", number):
                    _try_words(cell, catalogue)
    return _with_accepted(project, cells)


@dataclass(frozen=True)
class _Check:
    """One check with all that stands around it."""

    project: Project
    catalogue: Catalogue
    table: CheckTable
    overrides: Options

    def cells(self) -> list[ProjectCell]:
        """Return its cells: the product of all axes, less what is excluded, with what is included."""
        self._require_known()
        axes = {spelled(n): values for n, values in self.table.matrix.items() if spelled(n) not in self.won}
        rows = [
            {"policy": policy, "map": map_, **dict(zip(axes, values, strict=True))}
            for policy in self._files("policies")
            for map_ in self._files("maps")
            for values in product(*axes.values())
        ]
        for entry in self.table.exclude:
            rows = _without(rows, _spelled(entry), {*_PLACES, *axes})
        cells = [self._cell(row) for row in [*rows, *map(self._included, self.table.include)]]
        if not cells:
            raise ConfigurationError(
                f"the check '{self.table.title}' has no cells",
                "name policies and maps in the project, or in it",
            )
        return cells

    @property
    def own(self) -> Options:
        """Return the options that stand in the check itself."""
        return self.table.model_extra or {}

    @property
    def won(self) -> Options:
        """Return the options of the command line that its command has."""
        return {n: value for n, value in self.overrides.items() if self.catalogue.has(self.table.kind, n)}

    def _require_known(self) -> None:
        kind = [self.table.kind]
        entries = [*self._files("policies").values(), *self._files("maps").values()]
        for options in (self.own, self.table.matrix, *(entry.model_extra or {} for entry in entries)):
            self.catalogue.require(kind, options)
        self.catalogue.require(kind, self.table.gate, gate=True)

    def _files(self, which: str) -> dict[str, FileEntry]:
        """Return the policies or maps of the check by name: its own, those of the project, or files."""
        project, own = _entries(getattr(self.project.file, which)), getattr(self.table, which)
        if own is None:
            return project
        if isinstance(own, dict):
            return _entries(own)
        return _unique(pair for text in own for pair in _named(text, project).items())

    def _included(self, entry: Options) -> dict[str, Any]:
        """Return one cell more."""
        row = _spelled(entry)
        if missing := [name for name in _PLACES if not isinstance(row.get(name), str)]:
            raise ConfigurationError(
                f"include: a cell more lacks its '{missing[0]}'", f"add {missing[0]} = NAME"
            )
        options = {name: value for name, value in row.items() if name not in (*_PLACES, "gate")}
        self.catalogue.require([self.table.kind], options)
        self.catalogue.require([self.table.kind], row.get("gate", {}), gate=True)
        return row

    def _cell(self, row: Options) -> ProjectCell:
        (policy, policy_entry), (map_, map_entry) = (
            self._found(row["policy"], "policies"),
            self._found(row["map"], "maps"),
        )
        chosen = {n: value for n, value in row.items() if n not in (*_PLACES, "gate") and n not in self.won}
        layers = (
            self._default_options(),
            policy_entry.model_extra or {},
            map_entry.model_extra or {},
            self.own,
            self.table.gate,
            chosen,
            row.get("gate", {}),
            self.won,
        )
        title, labels = self.table.title, [f"{name}={_label(value)}" for name, value in chosen.items()]
        return ProjectCell(
            "/".join([title, policy, map_, *labels]),
            title,
            self.table.kind,
            policy,
            map_,
            policy_entry.file,
            map_entry.file,
            chosen,
            {spelled(name): value for layer in layers for name, value in layer.items()},
        )

    def _found(self, name: str, which: str) -> tuple[str, FileEntry]:
        known = {**_entries(getattr(self.project.file, which)), **self._files(which)}
        return next(iter(_named(name, known).items()))

    def _default_options(self) -> Options:
        defaults = {**self.project.file.defaults, **self.project.file.defaults.get("gate", {})}
        return {n: v for n, v in defaults.items() if n != "gate" and self.catalogue.has(self.table.kind, n)}


def _without(rows: list[dict[str, Any]], entry: Options, axes: set[str]) -> list[dict[str, Any]]:
    """Return the rows that an exclusion leaves."""
    if stray := [name for name in entry if name not in axes]:
        raise ConfigurationError(f"exclude: '{stray[0]}' is no axis", f"name {', '.join(sorted(axes))}")
    kept = [row for row in rows if not all(row[name] == value for name, value in entry.items())]
    if len(kept) == len(rows):
        wanted = ", ".join(f"{name} = {value!r}" for name, value in entry.items())
        raise ConfigurationError(f"exclude: no cell has {wanted}", "correct it, or take it out")
    return kept


def _check_defaults(project: Project, catalogue: Catalogue) -> None:
    """Refuse defaults that no check could have."""
    defaults = dict(project.file.defaults)
    gate, kinds = defaults.pop("gate", {}), list(catalogue.commands)
    with _told_at(project, "defaults"):
        catalogue.require(kinds, defaults)
        if not isinstance(gate, Mapping):
            raise ConfigurationError("'gate' is not a table", "write gate = { fail-under = 0.95 }")
        catalogue.require(kinds, gate, gate=True)


def _refuse_same_names(project: Project, cells: Sequence[ProjectCell]) -> None:
    names = [cell.folder.casefold() for cell in cells]
    for cell in cells:
        if names.count(cell.folder.casefold()) > 1:
            raise ConfigurationError(
                f"{project.path}: two cells are called '{cell.name}'",
                "give policies and maps names of their own",
            )


def _try_words(cell: ProjectCell, catalogue: Catalogue) -> None:
    """Let the command itself read the words of a cell."""
    try:
        catalogue.command(cell.kind).make_context(cell.kind, cell.arguments(catalogue))
    except click.UsageError as error:
        raise ConfigurationError(
            f"cell '{cell.name}': {error.format_message()}", f"run viatool {cell.kind} --help for the options"
        ) from error


def _with_accepted(project: Project, cells: Sequence[ProjectCell]) -> tuple[ProjectCell, ...]:
    """Give each cell what is accepted in it."""
    accepted: dict[str, list[Acceptance]] = {cell.name: [] for cell in cells}
    for number, one in enumerate(project.file.accepted):
        within = [cell for cell in cells if f"{cell.name}/".startswith(f"{one.cell}/")]
        if not one.cell or not within:
            what = f"no cell is '{one.cell}'" if one.cell else "the accepted finding names no cell"
            raise project.wrong(("accepted", number), what, "see the cells with viatool run --list")
        for cell in within:
            accepted[cell.name].append(one)
    return tuple(replace(cell, accepted=tuple(accepted[cell.name])) for cell in cells)


def _entries(files: Files) -> dict[str, FileEntry]:
    if isinstance(files, dict):
        return {n: FileEntry(file=f) if isinstance(f, str) else f for n, f in files.items()}
    return _unique((_stem(file), FileEntry(file=file)) for file in files)


def _unique(entries: Iterable[tuple[str, FileEntry]]) -> dict[str, FileEntry]:
    """Return entries by name.

    Raises
    ------
    ConfigurationError
        If two have one name, of which one would be left out in silence.
    """
    found: dict[str, FileEntry] = {}
    for name, entry in entries:
        if name in found:
            raise ConfigurationError(
                f"'{found[name].file}' and '{entry.file}' are both called '{name}'",
                "give them names, such as policies = { old = 'a/x.onnx', new = 'b/x.onnx' }",
            )
        found[name] = entry
    return found


def _named(text: str, known: Mapping[str, FileEntry]) -> dict[str, FileEntry]:
    """Return the entry of that name, or else the file or sample of that name."""
    return {text: known[text]} if text in known else _entries([text])


def _stem(file: str) -> str:
    """Return what a file is called in the names of cells."""
    return re.sub(r"[^\w.+-]", "-", PurePath(file).stem if PurePath(file).suffix in _SUFFIXES else file)


_SUFFIXES = (".onnx", ".yaml", ".yml", ".zip")


def _label(value: Any) -> str:
    """Return a value in the name of a cell."""
    if isinstance(value, Mapping):
        return "+".join(f"{name}-{_label(part)}" for name, part in value.items())
    if isinstance(value, list | tuple):
        return "+".join(map(_label, value))
    return _stem(PurePath(value).name if isinstance(value, str) else str(value))


def _spelled(entry: Options) -> dict[str, Any]:
    return {spelled(name): value for name, value in entry.items()}


@contextmanager
def _told_at(project: Project, *location: str | int) -> Iterator[None]:
    """Tell errors with their place in the project file."""
    try:
        yield
    except ConfigurationError as error:
        named = re.search(r"'([\w-]+)'", error.message)
        place = (*location, named[1]) if named else location
        raise project.wrong(place, error.message, error.hint) from error
