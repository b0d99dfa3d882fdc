"""The JSON schema of scene files, for editors: made from the records, so that it cannot drift from what a file may say.

Draft 2020-12. It knows the shape of a file: sections, kinds, fields, words, bounds of single values. What values must
satisfy together, and the geometry, is left to `diffeed.check`; so are infinities and NaN, which JSON does not have, and a
whole number written as 20.0, which is none in TOML.
"""

import json
from typing import Any

import numpy as np

from diffeed.base.limits import MAX_BARS, MAX_PARTS, MAX_POINTS
from diffeed.base.records import REQUIRED, fields, is_required
from diffeed.base.words import LONGEST, NAME
from diffeed.input.check_values import VARYING, Field
from diffeed.input.parts import OF_THE_FIELD, SECTIONS, Motion, Profile, Scene

DRAFT = "https://json-schema.org/draft/2020-12/schema"
_BOUNDS: dict[str, dict[str, Any]] = {"positive": {"exclusiveMinimum": 0}, "nonnegative": {"minimum": 0}, "any": {}}
_TYPES: dict[type, dict[str, Any]] = {
    str: {"type": "string"},
    bool: {"type": "boolean"},
    int: {"type": "integer", "minimum": 1, "maximum": MAX_BARS},
    float: {"type": "number", "exclusiveMinimum": 0},
    object: {"anyOf": [{"enum": ["lead", "tail"]}, {"type": "integer", "minimum": 0}]},
}
"""Of words: the only whole number counts bars, the only plain one is a duration, and `object` names a node or a bar."""


def scene_schema() -> dict[str, Any]:
    """The JSON schema of scene files, as plain values for `json.dumps`."""
    schema = _record(Scene)
    schema["properties"]["sheets"]["minProperties"] = 1
    return {
        "$schema": DRAFT,
        "title": "diffeed scene",
        **schema,
        "required": ["sheets"],
        "$defs": {kind.__name__: _record(kind, word) for kind, word in _kinds()},
    }


def schema_text(schema: dict[str, Any]) -> str:
    """A schema as the text of its file."""
    return json.dumps(schema, indent=2) + "\n"


def _kinds() -> list[tuple[type, str]]:
    """Every record that a scene holds, and the word that a file must give for it; empty where its section has one kind."""
    parts = [(kind, word if len(kinds) > 1 else "") for kinds in SECTIONS.values() for word, kind in kinds.items()]
    return [*parts, (Profile, ""), (Motion, "")]


def _record(kind: type, word: str = "") -> dict[str, Any]:
    """A table: its fields, those it must have, and no others."""
    properties, required = {f.name: _field(f) for f in fields(kind)}, [f.name for f in fields(kind) if is_required(f)]
    if word:
        properties = {"kind": {"const": word, "description": f"{kind.__name__}: {_first_sentence(kind)}"}} | properties
        required = ["kind", *required]
    return {
        "type": "object",
        "description": " ".join((kind.__doc__ or "").split()),
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }


def _first_sentence(kind: type) -> str:
    return " ".join((kind.__doc__ or "").split()).partition(". ")[0].rstrip(".")


def _field(field: Field) -> dict[str, Any]:
    meta = field.metadata
    if meta["role"] == "part":
        return _section(field) if meta["many"] else _one_part(field)
    schema = _word(field) if meta["role"] == "word" else _number(field)
    default = field.default
    if default is not REQUIRED and default is not None:
        schema["default"] = np.asarray(default).tolist()
    return schema


def _section(field: Field) -> dict[str, Any]:
    """Named parts of one kind, or of several that say which."""
    kinds = [_ref(kind) for kind in field.metadata["kinds"]]
    return {
        "type": "object",
        "description": field.metadata["doc"],
        "propertyNames": {"pattern": f"^(?:{NAME.pattern})$", "maxLength": LONGEST},
        "maxProperties": MAX_PARTS,
        "additionalProperties": kinds[0] if len(kinds) == 1 else {"type": "object", "oneOf": kinds},
    }


def _one_part(field: Field) -> dict[str, Any]:
    return {"description": field.metadata["doc"], **_ref(field.metadata["kinds"][0])}


def _ref(kind: type) -> dict[str, str]:
    return {"$ref": f"#/$defs/{kind.__name__}"}


def _word(field: Field) -> dict[str, Any]:
    choices = field.metadata["choices"]
    said: dict[str, Any] = {"enum": list(choices)} if choices else _TYPES[field.metadata["type"]]
    return {"description": field.metadata["doc"], **said}


def _number(field: Field) -> dict[str, Any]:
    schema = {"type": "number", **_BOUNDS[field.metadata["bound"]]}
    for length in reversed(field.metadata["shape"]):
        most = {"bars": MAX_BARS, "points": MAX_POINTS}.get(length, length)
        schema = {
            "type": "array",
            "items": schema,
            "minItems": 1 if isinstance(length, str) else length,
            "maxItems": most,
        }
    if field.name in VARYING:
        schema = {"anyOf": [schema, _ref(Profile)]}
    return {"description": _meaning(field), **schema}


def _meaning(field: Field) -> str:
    unit = field.metadata["unit"]
    if unit == "1":
        return field.metadata["doc"]
    return f"{field.metadata['doc']}; in {'the unit of the field' if unit == OF_THE_FIELD else unit}"
