"""Dependency types that name who may call a route: reader, submitter, curator, administrator.

**Conventions.** Whatever makes or ends a credential of one's own is an `AccountHolder`'s: a browser's session, or a
token with the scope for it. `Anybody` has some scope, and may end what they ask with (`tests/api/test_credentials.py`).
"""

from typing import Annotated

from fastapi import Depends

from api.deps import Caller, look, require, require_one
from services.runtime.access.roles import ACCOUNT, SCOPES

Looker = Annotated[Caller, Depends(look)]
Reader = Annotated[Caller, Depends(require("read"))]
Anybody = Annotated[Caller, Depends(require_one(SCOPES))]
AccountHolder = Annotated[Caller, Depends(require(ACCOUNT))]
Submitter = Annotated[Caller, Depends(require("submit"))]
Curator = Annotated[Caller, Depends(require("upload", "curator"))]
Administrator = Annotated[Caller, Depends(require("admin", "administrator"))]
