"""Help texts that name the entries of registers: a placeholder stands for each list, as registers load only where a text is shown."""

from collections.abc import Callable, Iterable
from typing import Any

from typer.core import TyperArgument, TyperCommand, TyperOption


def _either(names: Iterable[str]) -> str:
    """Names as a choice."""
    *most, last = names
    return f"{', '.join(most)} or {last}" if most else last


def _export_forms() -> str:
    from ..files.export_forms import FORMS

    return "; ".join(f"{form.name}: {form.description}" for form in FORMS.values())


def _whole_forms() -> str:
    from ..files.export_forms import OF_WHOLE_FILES

    return "; ".join(f"{name}: {description}" for name, description in OF_WHOLE_FILES.items())


def _forms_onto() -> str:
    from ..files.export_forms import FORMS

    return _either(form.name for form in FORMS.values() if form.onto is not None)


def _read_forms() -> str:
    from ..files.export_forms import FORMS

    return ", ".join(form.title for form in FORMS.values() if form.read is not None)


def _log_formats() -> str:
    from ..files.logs.formats import FORMATS

    return _either(form.name for form in FORMATS)


LISTS: dict[str, Callable[[], str]] = {
    "{export forms}": _export_forms,
    "{whole forms}": _whole_forms,
    "{forms onto}": _forms_onto,
    "{read forms}": _read_forms,
    "{log formats}": _log_formats,
}


def with_lists(text: str) -> str:
    """Help text with lists in the place of placeholders."""
    for placeholder, listing in LISTS.items():
        if placeholder in text:
            text = text.replace(placeholder, listing())
    return text


class ListingCommand(TyperCommand):
    """Command whose help has lists in the place of placeholders."""

    def get_help(self, ctx: Any) -> str:  # typer's own, which it does not publish
        listed = [one for one in self.params if isinstance(one, TyperArgument | TyperOption) and one.help]
        texts = [one.help or "" for one in listed]
        try:
            for one, text in zip(listed, texts, strict=True):
                one.help = with_lists(text)
            return super().get_help(ctx)
        finally:  # the next help may be of more entries
            for one, text in zip(listed, texts, strict=True):
                one.help = text
