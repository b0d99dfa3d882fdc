"""The JSON schemas of study files, for editors: made by pydantic from the records, with the words that a study may use.

Parts and sensors are names of the scene: whether they fit, `optimize.make_problem` says.
"""

from typing import Any

from pydantic import BaseModel

import diffeed
from diffeed.base.words import LONGEST, NAME
from diffeed.schema import DRAFT
from optimize.optimisers import OPTIMISERS
from optimize.study import Study
from optimize.terms import TERMS
from optimize.tolerance.records import ToleranceStudy

STUDIES: dict[str, type[BaseModel]] = {"design": Study, "tolerance": ToleranceStudy}
"""Record of each kind of study file."""
_WORDS = {"measure": TERMS, "method": diffeed.METHODS}


def study_schema(kind: str) -> dict[str, Any]:
    """The JSON schema of "design" or "tolerance" studies, as plain values for `json.dumps`."""
    schema = _without_null(STUDIES[kind].model_json_schema())
    for record in (schema, *schema["$defs"].values()):
        for name, field in record.get("properties", {}).items():
            if name in _WORDS:
                field["enum"] = list(_WORDS[name])
            if isinstance(field.get("additionalProperties"), dict):  # a table of things that the file names
                field["propertyNames"] = {"pattern": f"^(?:{NAME.pattern})$", "maxLength": LONGEST}
    if kind == "design":
        schema["$defs"]["Search"]["properties"]["name"]["enum"] = list(OPTIMISERS)
    return {"$schema": DRAFT, **schema, "title": f"diffeed {kind} study"}


def _without_null(node: Any) -> Any:
    """The same without the null that pydantic allows for what is not given: TOML has none."""
    if isinstance(node, list):
        return [_without_null(v) for v in node]
    if not isinstance(node, dict):
        return node
    found = {k: _without_null(v) for k, v in node.items() if v is not None}
    kept = [v for v in found.get("anyOf", ()) if v != {"type": "null"}]
    if len(kept) == 1:
        del found["anyOf"]
        return found | kept[0]
    return found | {"anyOf": kept} if kept else found
