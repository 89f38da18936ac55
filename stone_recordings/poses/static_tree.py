"""Fixed transforms between named frames, and the path from one frame to another."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from stone.geometry.se3 import SE3


@dataclass(frozen=True, eq=False)
class StaticTree:
    """`edges[(dst, src)]` is `dst_from_src`, in both directions; `down` are the pairs as (parent, child)."""

    edges: dict[tuple[str, str], SE3]
    down: frozenset[tuple[str, str]] = frozenset()

    @staticmethod
    def of(given: Iterable[tuple[str, str, SE3]]) -> "StaticTree":
        """Build the tree from (parent, child, parent_from_child); the last transform of a pair counts."""
        edges: dict[tuple[str, str], SE3] = {}
        down = set[tuple[str, str]]()
        for parent, child, parent_from_child in given:
            edges[(parent, child)] = parent_from_child
            edges[(child, parent)] = parent_from_child.inverse()
            down = (down - {(child, parent)}) | {(parent, child)}
        return StaticTree(edges, frozenset(down))

    def is_down(self, parent: str, child: str) -> bool:
        return (parent, child) in self.down

    @property
    def unplaced(self) -> tuple[str, ...]:
        """The frames below others, if there are several and all translations are zero; else none."""
        places = [self.edges[pair].translation_m for pair in self.down]
        is_unplaced = len(places) > 1 and not any(translation.any() for translation in places)
        return tuple(sorted(child for _, child in self.down)) if is_unplaced else ()

    def recorded(self, dst: str, src: str) -> SE3 | None:
        """Return `transform`, but None between a frame and itself, which no message contains."""
        return self.transform(dst, src) if dst != src else None

    def transform(self, dst: str, src: str) -> SE3 | None:
        """Return `dst_from_src` along the shortest path, or None if the frames are not connected."""
        near: dict[str, list[str]] = {}
        for frame, far in self.edges:
            near.setdefault(frame, []).append(far)
        seen, waiting = {dst}, deque([(dst, SE3.identity())])
        while waiting:
            frame, dst_from_frame = waiting.popleft()
            if frame == src:
                return dst_from_frame
            for far in near.get(frame, []):
                if far not in seen:
                    seen.add(far)
                    waiting.append((far, dst_from_frame @ self.edges[(frame, far)]))
        return None
