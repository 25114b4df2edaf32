"""gainroom example: files to start from."""

from typing import Annotated

import typer

from .options import AsJson
from .output import emit, emit_json


def example(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Which one; without it, the list.", show_default=False)] = None,
    as_json: AsJson = False,
) -> int:
    """Print a ready file to start from.

    \b
    Example:
      gainroom example testbed > joint.yaml
    """
    texts = example_texts()
    summaries = {each: text.partition("\n")[0].removeprefix("#").strip() for each, text in texts.items()}
    if name is None:
        if as_json:
            emit_json({"examples": [{"name": each, "summary": summary} for each, summary in summaries.items()]})
        else:
            width = max(map(len, summaries)) + 2
            emit("".join(f"{each:{width}}{summary}\n" for each, summary in summaries.items()))
        return 0
    if name not in texts:
        from ..errors import GainroomError
        from ..io.yaml_text import shown

        raise GainroomError(f"example {shown(name)}: must be one of {', '.join(texts)}")
    if as_json:
        emit_json({"name": name, "summary": summaries[name], "text": texts[name]})
    else:
        emit(texts[name])
    return 0


def example_texts() -> dict[str, str]:
    """Shipped files by name."""
    from importlib.resources import files

    folder = files("gainroom") / "files" / "examples"
    found = {entry.name.removesuffix(".yaml"): entry for entry in folder.iterdir() if entry.name.endswith(".yaml")}
    return {name: found[name].read_text("utf-8") for name in sorted(found)}


def joint_examples() -> dict[str, str]:
    """Examples for `gainroom joint`, by name."""
    return {name: text for name, text in example_texts().items() if "\njoint:" in text}
