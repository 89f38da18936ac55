"""Numbers of voxels by traversability class over the wire."""

from pydantic import AliasChoices, Field

from api.schemas.base import Answer, example


class ClassCounts(Answer):
    """Numbers of voxels by traversability class; `free` is null if free voxels were not counted."""

    model_config = example(free=2000000, traversable=1842003, potentially_traversable=2700114, non_traversable=5811201)

    free: int | None = None
    traversable: int = Field(validation_alias=AliasChoices("T", "traversable"))
    potentially_traversable: int = Field(validation_alias=AliasChoices("P", "potentially_traversable"))
    non_traversable: int = Field(validation_alias=AliasChoices("N", "non_traversable"))
