"""Where the file of a robot's model is: a path, a file in an installed package, or a name of `robot_descriptions`."""

import contextlib
import difflib
import importlib
import importlib.metadata
import importlib.resources
import importlib.util
import os
import pkgutil
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from ...errors import GainroomError, nearest, one_line

ENDINGS = (".urdf", ".xml")
CATALOGUE = "robot_descriptions"
OURS = "gainroom"
PROJECT = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9._-]{0,60}[A-Za-z0-9])")
"""What a Python package may be called (PEP 508), of two characters at least."""


def locate(file: str | Path | Mapping[str, str]) -> Path:
    """Path of a model file named as in load_model; a path is returned unchanged. Raises GainroomError for unknown packages and names."""
    if isinstance(file, Mapping):
        if set(file) != {"package", "file"} or not all(isinstance(value, str) for value in file.values()):
            raise GainroomError(f"model {dict(file)!r} must be {{package: …, file: …}}")
        return _shipped(file["file"]) if file["package"] == OURS else _in_package(file["package"], file["file"])
    if isinstance(file, str) and re.match(r"[A-Za-z][A-Za-z0-9+.-]*://", file):
        raise GainroomError(f"model: {one_line(repr(file), 120)} is an address; download it, with what it includes, and give the file")
    if isinstance(file, str) and file.lstrip().startswith("<"):
        raise GainroomError("model: is XML text; give a file, or mujoco.MjModel.from_xml_string of it")
    if isinstance(file, str) and is_name(file):
        package, colon, inside = file.partition(":")
        return locate({"package": package, "file": inside}) if colon else _in_catalogue(file)
    return Path(file)


def is_name(file: str) -> bool:
    """True if `file` is no path but PACKAGE:FILE, or the name of a robot in robot_descriptions."""
    return not os.path.exists(file) and (file.isidentifier() or re.fullmatch(r"[\w.-]{2,}:[^:/][^:]*\.(urdf|xml)", file) is not None)


def _shipped(file: str) -> Path:
    """Path of a model that is shipped with gainroom."""
    folder = Path(str(importlib.resources.files("gainroom") / "robot" / "models"))
    names = tuple(sorted(path.name for path in folder.iterdir() if path.suffix in ENDINGS))
    if file not in names:
        raise GainroomError(f"model.file: gainroom ships no {file[:60]!r}{nearest(file, names, 'model')}")
    return folder / file


def _in_package(package: str, file: str) -> Path:
    try:
        files = importlib.metadata.files(package)
    except (importlib.metadata.PackageNotFoundError, ValueError) as error:
        installed = sorted({found.name for found in importlib.metadata.distributions() if found.name})
        close = difflib.get_close_matches(package, installed, 1)
        hint = f"; did you mean {close[0]!r}?" if close else f": pip install {package}" if PROJECT.fullmatch(package) else ""
        raise GainroomError(f"model: package {one_line(repr(package), 60)} is not installed{hint}") from error
    models = {str(each): each for each in files or () if each.suffix in ENDINGS}
    found = [name for name in models if f"/{name}".endswith(f"/{file}")]
    if len(found) > 1 and file not in found:
        raise GainroomError(f"model: {file!r} in package {package} may be {' or '.join(found[:3])}; give more of the path")
    if not found:
        raise GainroomError(f"model: package {package} has no {file!r}{_nearest_file(file, list(models))}")
    return Path(str(models[file if file in found else found[0]].locate()))


def _nearest_file(file: str, names: Sequence[str]) -> str:
    """End of a message with the known file whose path ends most like `file`; "" if none is similar."""
    parts = file.count("/") + 1
    ends = sorted({"/".join(name.split("/")[-parts:]) for name in names})
    close = difflib.get_close_matches(file, ends, 3, cutoff=0.4)
    return f"; nearest are {', '.join(close)}" if close else f" (it has {len(names)} files that end in .urdf or .xml)"


def _in_catalogue(name: str) -> Path:
    """Path of the model of a robot in robot_descriptions, which downloads it on first use."""
    spec = importlib.util.find_spec(CATALOGUE)
    if spec is None:
        raise GainroomError(f"model {name!r}: no such file; for names of robots, pip install {CATALOGUE}")
    names = [module.name for module in pkgutil.iter_modules(spec.submodule_search_locations) if module.name.endswith("_description")]
    if name not in names:
        raise GainroomError(f"model {name!r}: no such file, and {CATALOGUE} has no such robot{nearest(name, names, 'robot')}")
    with contextlib.redirect_stdout(sys.stderr):  # it says that it downloads
        try:
            module = importlib.import_module(f"{CATALOGUE}.{name}")
        except (ImportError, OSError, RuntimeError, ValueError) as error:
            raise GainroomError(f"model {name!r}: {CATALOGUE} cannot provide it: {one_line(error)}") from error
    path = getattr(module, "URDF_PATH", None) or getattr(module, "MJCF_PATH", None)
    if path is None:
        raise GainroomError(f"model {name!r}: {CATALOGUE} has neither a URDF nor an MJCF of it")
    return Path(path)
