"""Reading a scene file, and saying what is wrong with it: one line a problem, with file, key and remedy."""

from __future__ import annotations

import tomllib
from pathlib import Path

from pydantic import ValidationError

from mic.errors import SceneError
from mic.scene.schema import Scene

__all__ = ["load_scene"]


def load_scene(path) -> Scene:
    """Read and validate a scene file.

    Parameters
    ----------
    path : path-like
        A TOML file, or a folder that holds ``scene.toml``.

    Raises
    ------
    SceneError
        With one line per problem: file, key, what is wrong, what to do.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "scene.toml"
    try:
        with open(path, "rb") as file:
            table = tomllib.load(file)
    except FileNotFoundError:
        raise SceneError(f"{path}: there is no such scene file; check the path") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: not valid TOML: {error}; mend the syntax there") from None
    except RecursionError:
        raise SceneError(
            f"{path}: tables or lists are nested too deeply; a scene needs no more than three levels"
        ) from None
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({str(error.strerror).lower()}); check the path") from None
    if "folder" in table:
        raise SceneError(f"{path}: folder: unknown key; remove it")
    try:
        return Scene(**table, folder=path.parent.resolve())
    except ValidationError as error:
        raise SceneError("\n".join(_explain(path, item) for item in error.errors())) from None


def _explain(path, item) -> str:
    """One line for one problem found by the validation."""
    key = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in _keys(item["loc"])).lstrip(".")
    message = item["msg"].removeprefix("Value error, ")
    given = item.get("input")
    remedy = {
        "extra_forbidden": "unknown key; remove it or mend its spelling",
        "missing": "required key is missing; add it",
        "greater_than": f"{message}; got {given!r}, correct the value",
        "greater_than_equal": f"{message}; got {given!r}, correct the value",
        "finite_number": f"{message}; got {given!r}, give a finite number",
        "union_tag_not_found": "required key kind is missing; add it",
        "union_tag_invalid": f"kind must be one of {item.get('ctx', {}).get('expected_tags')}; correct it",
        "value_error": message,
    }
    text = remedy.get(item["type"], f"{message}; got {given!r}, correct it")
    if not key:
        return "\n".join(f"{path}: {line}" for line in text.splitlines())
    return f"{path}: {key}: {text}" if key else f"{path}: {text}"


#: How pydantic, and this schema, tell the alternatives of one key apart.
ALTERNATIVES = ("literal[", "constrained", "float", "str", "function", "friction-")


def _keys(location) -> list[str | int]:
    """The keys of a validation error's location, without the words with which pydantic tells alternatives apart."""
    keys = [step for step in location if not (isinstance(step, str) and step.startswith(ALTERNATIVES))]
    if keys[:1] == ["deviations"] and len(keys) > 2:
        del keys[2]  # the kind that chose the table
    return keys
