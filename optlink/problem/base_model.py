"""Base class of all sections of a problem file, and names."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict

from optlink.linkage.mechanism import FRAME
from optlink.problem.quantity import Unusable

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}", re.ASCII)
RESERVED = (FRAME, "input", "energy")


class Section(BaseModel):
    """A table of the problem file."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)  # most unused


def _read_name(raw: object) -> str:
    if not isinstance(raw, str) or not _NAME.fullmatch(raw):
        raise Unusable("not a name", "Use letters, digits and _, beginning with a letter, for example link2", "", raw)
    return raw


Name = Annotated[str, BeforeValidator(_read_name)]
"""Of a body, a point, a guide or a load."""
