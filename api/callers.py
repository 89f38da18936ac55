"""Dependency types that name who may call a route: reader, submitter, curator, administrator."""

from typing import Annotated

from fastapi import Depends

from api.deps import Caller, look, require

Looker = Annotated[Caller, Depends(look)]
Reader = Annotated[Caller, Depends(require("read"))]
Submitter = Annotated[Caller, Depends(require("submit"))]
Curator = Annotated[Caller, Depends(require("upload", "curator"))]
Administrator = Annotated[Caller, Depends(require("admin", "administrator"))]
