"""Checks the files that ship the project, each by its own linter: workflows, issue forms, citation, Dockerfile, package.xml, hooks."""

import subprocess
import sys
from pathlib import Path

from catkin_pkg.package import InvalidPackage, parse_package

TOOLS = Path(sys.executable).parent
GITHUB = Path(".github")


def schema(name: str, *files: Path) -> tuple[str, ...]:
    """Check by one of the schemas that check-jsonschema brings along."""
    return "check-jsonschema", "--builtin-schema", f"vendor.{name}", *map(str, files)


COMMANDS = (
    ("actionlint", *map(str, (GITHUB / "workflows").iterdir())),
    ("zizmor", "--offline", "--no-progress", "--quiet", str(GITHUB)),
    schema("citation-file-format", Path("CITATION.cff")),
    schema("dependabot", GITHUB / "dependabot.yml"),
    schema("github-issue-config", GITHUB / "ISSUE_TEMPLATE" / "config.yml"),
    schema("github-issue-forms", *(path for path in (GITHUB / "ISSUE_TEMPLATE").iterdir() if path.name != "config.yml")),
    ("hadolint", "Dockerfile"),
    ("validate-pyproject", "pyproject.toml"),
    ("pre-commit", "validate-config", ".pre-commit-config.yaml"),
)


def main() -> int:
    """Exit status: 0 nothing found, else 1; what a linter says is printed where it found something."""
    failed = False
    for name, *words in COMMANDS:
        done = subprocess.run([str(TOOLS / name), *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        if done.returncode:
            print(f"{name} {' '.join(words)}\n{done.stdout}", file=sys.stderr)
            failed = True
    said: list[str] = []
    try:
        parse_package("package.xml", warnings=said)
    except InvalidPackage as error:
        said.append(str(error))
    if said:
        print("package.xml:", *said, sep="\n", file=sys.stderr)
    return int(failed or bool(said))


sys.exit(main())
