"""Run the blocks and commands of pages: `python runner.py FOLDER PAGE ...` prints a JSON object of their outputs.

The pages run in a copy of FOLDER with the measured data as data/. Effects that a page registers stay here.
"""

import ast
import contextlib
import dataclasses
import fcntl
import functools
import gc
import hashlib
import inspect
import io
import json
import os
import pickle
import runpy
import shlex
import shutil
import sys
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

KEPT_IN = "CVXSHEAR_TESTS_KEEP"
"""The variable that names the folder of what is computed once for all processes of a test run."""

FENCE = "```"

IMPORTS_ALONE = {"noise-study.md": "its block takes minutes"}
"""Pages with python blocks that take too long for a test: only their imports are run. The word no-run after its fence
marks a single block."""


MEASURED = Path(os.environ.get("CVXSHEAR_SHARED", Path(__file__).resolve().parents[3] / "shared")) / "data"
"""Measured data beside the project; blocks marked needs-data run where they are."""


@dataclass(frozen=True)
class Block:
    """A fenced block: the words after its fence, its text, the line it begins at."""

    words: tuple[str, ...]
    text: str
    line: int

    @property
    def language(self) -> str:
        return self.words[0] if self.words else ""

    @property
    def runs(self) -> bool:
        return "no-run" not in self.words and not self.lacks_data

    @property
    def lacks_data(self) -> bool:
        """Whether it reads measured data that are not here."""
        return "needs-data" in self.words and not MEASURED.is_dir()


def blocks(page: str) -> list[Block]:
    """The fenced blocks of a Markdown page in order."""
    found: list[Block] = []
    fence, words, start, lines = "", (), 0, []
    for number, line in enumerate(page.splitlines(), 1):
        mark = line[: len(line) - len(line.lstrip("`"))]
        if not fence and len(mark) >= len(FENCE):
            fence, words, start, lines = mark, tuple(line[len(mark) :].split()), number + 1, []
        elif fence and line.strip() == fence:
            found.append(Block(words, "\n".join(lines), start))
            fence = ""
        elif fence:
            lines.append(line)
    if fence:
        raise ValueError(f"the fence before line {start} is never closed")
    return found


def commands(block: Block) -> list[tuple[str, str]]:
    """The commands of a console block, each with the output shown below it."""
    found: list[tuple[str, list[str]]] = []
    for line in block.text.splitlines():
        if line.startswith("$ "):
            found.append((line[2:], []))
        elif found:
            found[-1][1].append(line)
    return [(command, "\n".join(shown)) for command, shown in found]


def run_command(command: str) -> None:
    """Run `cvxshear ...`, `python SCRIPT` or `cat FILE` here; raises unless it ends with status 0."""
    # A comment at the end is for the reader.
    program, *arguments = shlex.split(command, comments=True)
    if program == "cvxshear":
        from cvxshear.cli import main  # noqa: PLC0415

        try:
            main(arguments)
        except SystemExit as ended:
            if ended.code not in (0, None):
                raise RuntimeError(f"{command}: exit status {ended.code}") from None
    elif program == "python" and len(arguments) == 1:
        runpy.run_path(arguments[0], run_name="__main__")
    elif program == "cat" and len(arguments) == 1:
        print(Path(arguments[0]).read_text(encoding="utf-8"))
    else:
        raise RuntimeError(f"the documentation shows a command that its tests do not run: {command}")


def run_python(block: Block, namespace: dict[str, object], page: Path) -> None:
    """Run a python block; of one marked no-run the imports alone, so that no name in it is stale."""
    tree = ast.parse(block.text)
    if not block.runs or page.name in IMPORTS_ALONE:
        tree.body = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    ast.increment_lineno(tree, block.line - 1)
    exec(compile(tree, str(page), "exec"), namespace)


def run_page(page: Path) -> dict[str, str]:
    """Return the output of each block of a page, by "line" or, for the n-th command of a block, "line:n".

    The key "error" holds the first failure; later blocks were not run.
    """
    printed: dict[str, str] = {}
    namespace: dict[str, object] = {"__name__": "__main__"}
    for block in blocks(page.read_text(encoding="utf-8")):
        errors = io.StringIO()
        out = io.StringIO()
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
                if block.language == "python":
                    # A reader pastes each block of the gallery by itself.
                    fresh = {"__name__": "__main__"} if page.parent.name == "gallery" else namespace
                    run_python(block, fresh, page)
                    printed[str(block.line)] = out.getvalue()
                elif block.language == "console" and block.runs:
                    for place, (command, _) in enumerate(commands(block)):
                        out.seek(0)
                        out.truncate()
                        run_command(command)
                        printed[f"{block.line}:{place}"] = out.getvalue()
        except Exception:
            printed["error"] = f"{page.name}, block at line {block.line}:\n{errors.getvalue()}{traceback.format_exc()}"
            return printed
    return printed


def once(function: Callable[P, R]) -> Callable[P, R]:
    """Return the function with a cache of its results by arguments.

    Pages and tests use the same frames many times. If the variable `KEPT_IN` names a folder, processes share the
    results. Objects that cannot be pickled, such as an effect that a page defines, are computed every time, and so is
    everything after a page has registered something.
    """
    made: dict[bytes, R] = {}
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        from cvxshear.data import noise_kinds  # noqa: PLC0415
        from cvxshear.effects import catalogue  # noqa: PLC0415

        given = signature.bind(*args, **kwargs)
        given.apply_defaults()
        if any(isinstance(each, str | os.PathLike) and os.path.exists(each) for each in given.arguments.values()):
            # A file of the same name may hold something else next time.
            return function(*args, **kwargs)
        registered = [each.name for each in catalogue()], sorted(noise_kinds())
        written = io.BytesIO()
        try:
            values = {name: tuple(each) if isinstance(each, list) else each for name, each in given.arguments.items()}
            Fields(written).dump((function.__name__, sorted(values.items()), registered))
        except (pickle.PicklingError, AttributeError, TypeError, ValueError):
            return function(*args, **kwargs)
        key = written.getvalue()
        if key not in made:
            made[key] = kept(hashlib.sha256(key).hexdigest(), functools.partial(function, *args, **kwargs))
        return made[key]

    return call


def effects_of_the_package() -> dict[str, object]:
    from cvxshear.effects import catalogue, open_classes  # noqa: PLC0415

    return {each.name: each for each in (*catalogue(), *open_classes())}


class Fields(pickle.Pickler):
    """Writes equal things alike, whatever has been computed of them and whichever of their parts are one object."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self.fast = True

    def reducer_override(self, obj: object) -> object:
        if dataclasses.is_dataclass(obj) and not isinstance(obj, type):
            return type(obj), tuple(getattr(obj, each.name) for each in dataclasses.fields(obj) if each.init)
        return NotImplemented


class Writer(pickle.Pickler):
    """Effects that come with the package are themselves, not a copy, where they are read again."""

    def persistent_id(self, obj: object) -> str | None:
        return next((name for name, each in effects_of_the_package().items() if each is obj), None)


class Reader(pickle.Unpickler):
    """Reads what `Writer` wrote."""

    def persistent_load(self, pid: str) -> object:
        return effects_of_the_package()[pid]


def kept(name: str, make: Callable[[], R]) -> R:
    """Return the content of the file of this name in the folder `KEPT_IN`; make the file if it is missing."""
    folder = os.environ.get(KEPT_IN)
    if folder is None:
        return make()
    path = Path(folder) / name
    # Processes wait while another one makes the file.
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            made = make()
            # The file is there as a whole or not at all.
            with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
                Writer(file).dump(made)
            os.replace(file.name, path)
            return made
    with path.open("rb") as file:
        result: R = Reader(file).load()
    return result


def share() -> None:
    """From here on this process closes loops, identifies modes and draws reports once, see `once`."""
    import cvxshear.io.modes  # noqa: PLC0415
    import cvxshear.records  # noqa: PLC0415
    import cvxshear.screening  # noqa: PLC0415

    cvxshear.close_loop = cvxshear.screening.close_loop = once(cvxshear.close_loop)
    cvxshear.io.modes.identify_modes = cvxshear.records.identify_modes = once(cvxshear.records.identify_modes)
    # Modules that import the loop are imported after this.
    from cvxshear.report import html  # noqa: PLC0415

    html.drawings, html.compare_backends = once(html.drawings), once(html.compare_backends)
    # The search for garbage need not walk through what has been imported, as in `tests/conftest.py`.
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


def main(arguments: list[str]) -> None:
    share()
    examples, *pages = [Path(argument).resolve() for argument in arguments]
    results = {}
    for page in pages:
        with tempfile.TemporaryDirectory() as folder:
            shutil.copytree(examples, Path(folder) / "examples")
            if MEASURED.is_dir():
                (Path(folder) / "data").symlink_to(MEASURED)
            os.chdir(folder)
            results[str(page)] = run_page(page)
            os.chdir(examples)
    print(json.dumps(results))


if __name__ == "__main__":
    main(sys.argv[1:])
