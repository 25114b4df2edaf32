"""Compiles the C++ core for processors and systems other than this one, by zig's compiler, and links it as a module of this Python.

    python scripts/cross_compile.py [TARGET ...]

What is checked: every binding and nanobind compile and link for each target, and the file is one of that system. It is not run. Python's
headers are this interpreter's; what they take from the build of a Python, its pyconfig.h, is this file's own. zig comes as a wheel, into a
virtual environment of its own in build/cross.
"""

import argparse
import re
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOM = ROOT / "build" / "cross"
STABLE = ["-DPy_LIMITED_API=0x030C0000", "-include", "cstdio"] if sys.version_info >= (3, 12) else []
"""The stable ABI of Python 3.12, the first that nanobind can use; before, the interpreter's own.
cstdio as in CMakeLists.txt."""
TARGETS = {
    "aarch64-linux-gnu.2.17": b"\x7fELF",
    "x86_64-linux-musl": b"\x7fELF",
    "x86_64-macos": b"\xcf\xfa\xed\xfe",
    "aarch64-macos": b"\xcf\xfa\xed\xfe",
    "x86_64-windows-gnu": b"MZ",
}
"""zig's names, and how a library of such a system begins."""
EVERYWHERE = """
#define SIZEOF_SHORT 2
#define SIZEOF_INT 4
#define SIZEOF_LONG_LONG 8
#define SIZEOF_FLOAT 4
#define SIZEOF_DOUBLE 8
#define SIZEOF_FPOS_T 16
#define ALIGNOF_SIZE_T 8
#define SIZEOF_VOID_P 8
#define SIZEOF_SIZE_T 8
#define HAVE_STDINT_H 1
#define HAVE_INTTYPES_H 1
#define HAVE_WCHAR_H 1
#define WITH_DOC_STRINGS 1
"""
POSIX = """
#define SIZEOF_LONG 8
#define SIZEOF_WCHAR_T 4
#define SIZEOF_PID_T 4
#define SIZEOF_TIME_T 8
#define ALIGNOF_LONG 8
#define HAVE_SSIZE_T 1
#define HAVE_SYS_TYPES_H 1
#define HAVE_SYS_TIME_H 1
#define HAVE_UNISTD_H 1
#define HAVE_PTHREAD_H 1
"""
WINDOWS = """
#define MS_WINDOWS
#define MS_WIN64
#define MS_WIN32
#define SIZEOF_LONG 4
#define SIZEOF_WCHAR_T 2
#define SIZEOF_PID_T 4
#define SIZEOF_TIME_T 8
#define ALIGNOF_LONG 4
#define HAVE_DECLSPEC_DLL 1
#define Py_ENABLE_SHARED 1
#define NT_THREADS 1
typedef long long Py_ssize_t;
#define HAVE_PY_SSIZE_T 1
#define PY_SSIZE_T_MAX 9223372036854775807LL
"""


def main() -> None:
    """Compile for the targets that the command line names, or for all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}; default: all")
    targets = parser.parse_args().targets or list(TARGETS)
    if unknown := [target for target in targets if target not in TARGETS]:
        parser.error(f"target {unknown[0]} must be one of {', '.join(TARGETS)}")
    compiler = _zig()
    for target in targets:
        print(f"{target}: compiling ...", flush=True)
        size = _module(compiler, target).stat().st_size
        print(f"{target}: compiled and linked, {size / 2**20:.1f} MiB")


def _zig() -> list[str]:
    """Command of zig."""
    python = ROOM / "venv" / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    if not python.exists():
        print("installing zig ...", flush=True)
        venv.create(ROOM / "venv", with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "-q", "ziglang"], check=True)
    return [str(python), "-m", "ziglang"]


def _module(zig: list[str], target: str) -> Path:
    """The core for `target`; ends the program where the compiler or the linker does."""
    import nanobind

    room = ROOM / target
    room.mkdir(parents=True, exist_ok=True)
    windows, package = "windows" in target, Path(nanobind.__file__).parent
    (room / "pyconfig.h").write_text(EVERYWHERE + (WINDOWS if windows else POSIX), "utf-8")
    native = ROOT / "src" / "gainroom" / "native"
    bindings = room / "bindings.cpp"
    bindings.write_text("".join(f'#include "{file}"\n' for file in sorted((native / "bindings").glob("*.cpp"))), "utf-8")
    # pyconfig.h of this interpreter lies beside its headers: a copy without it.
    headers = _headers(room)
    common = [*zig, "c++", "-target", target, "-std=c++17", "-DNDEBUG", *STABLE, "-fvisibility=hidden"]
    common += [] if windows else ["-fPIC"]
    common += [
        f"-I{folder}" for folder in (room, headers, package / "include", native / "include", package / "ext" / "robin_map" / "include")
    ]
    for source, options in (  # -O1: whether it compiles, in half of the time
        (bindings, ["-O1", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror=return-type"]),
        (package / "src" / "nb_combined.cpp", ["-O1", "-DNB_BUILD", "-fno-strict-aliasing", "-w"]),
    ):
        _run([*common, *options, "-c", str(source), "-o", str(room / f"{source.stem}.o")])
    module = room / ("_core.pyd" if windows else "_core.abi3.so")
    objects = [str(room / "bindings.o"), str(room / "nb_combined.o")]
    link = [*zig, "c++", "-target", target, "-shared", *objects, "-o", str(module)]
    if windows:
        link.append(str(_import_library(zig, room)))
    elif "macos" in target:
        link.append("-Wl,-undefined,dynamic_lookup")
    _run(link)
    if not module.read_bytes().startswith(TARGETS[target]):
        sys.exit(f"{target}: {module} is no library of that system")
    return module


def _headers(room: Path) -> Path:
    """Folder of this Python's headers without its pyconfig.h."""
    own, copy = Path(sysconfig.get_path("include")), room / "python"
    for header in own.rglob("*.h"):
        if header.name != "pyconfig.h":
            place = copy / header.relative_to(own)
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(header.read_bytes())
    return copy


def _import_library(zig: list[str], room: Path) -> Path:
    """Import library of Python's DLL, of the names that the objects ask of it: that of CPython is not at hand."""
    library = "python3" if STABLE else "python{}{}".format(*sys.version_info)
    text = (room / "bindings.o").read_bytes() + (room / "nb_combined.o").read_bytes()
    names = sorted({match.decode() for match in re.findall(rb"(?:__imp_)?(_?Py[A-Za-z_0-9]+)\0", text)})
    (room / "python.def").write_text(f"LIBRARY {library}.dll\nEXPORTS\n" + "".join(f"  {name}\n" for name in names), "utf-8")
    _run([*zig, "dlltool", "-m", "i386:x86-64", "-d", str(room / "python.def"), "-l", str(room / "libpython.a")])
    return room / "libpython.a"


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(command)}\n{done.stderr}")
    if done.stderr:
        print(done.stderr, file=sys.stderr)


if __name__ == "__main__":
    main()
