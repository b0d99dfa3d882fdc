"""Where to put names in a picture so that they cover neither each other nor the parts. Units: points of the page."""

import dataclasses

import numpy as np

DIRECTIONS = 16
RINGS = (3.0, 10.0, 18.0, 28.0, 40.0, 54.0)
PER_DISTANCE, PER_WRONG_SIDE, PER_OBSTACLE, PER_OVERLAP = 0.25, 6.0, 2.0, 1.0
PER_CROSSED, ALONG = 4.0, 9
"""For each point, of so many along a leader line, that lies on a name: a name that is struck through is hard to read."""
PER_NEARER_OTHER = 1.0
"""For each point by which a label stands nearer to what another names than to its own: it would be read as that one's."""


@dataclasses.dataclass(frozen=True)
class Label:
    """A name, its size (width, height), the points it may stand beside and the side on which it should (or zero)."""

    text: str
    size: tuple[float, float]
    anchors: np.ndarray  # (anchors, 2)
    side: tuple[float, float] = (0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class Place:
    """Centre of a label and the anchor it belongs to."""

    center: np.ndarray
    anchor: np.ndarray


def place(labels: list[Label], obstacles: np.ndarray, frame: tuple[float, float, float, float]) -> list[Place]:
    """Greedy placement, longest first: each label takes the cheapest of its candidates, given those that stand already.

    `obstacles` (points, 2) are samples of everything drawn; `frame` is (left, bottom, right, top).
    """
    taken, leaders = np.zeros((0, 4)), np.zeros((0, 2))
    places: dict[int, Place] = {}
    for i in sorted(range(len(labels)), key=lambda i: -labels[i].size[0]):
        label = labels[i]
        centers, anchors, distance = _candidates(label)
        boxes = _boxes(centers, label.size)
        cost = PER_DISTANCE * distance + PER_WRONG_SIDE * ((centers - anchors) @ np.array(label.side) < 0.0)
        cost = cost + PER_OBSTACLE * _inside(boxes, obstacles).sum(axis=1)
        lines = anchors[:, None] + np.linspace(0.0, 1.0, ALONG)[:, None] * (centers - anchors)[:, None]
        struck = _inside(taken, lines.reshape(-1, 2)).sum(axis=0).reshape(len(centers), ALONG).sum(axis=1)
        cost = cost + PER_CROSSED * (struck + _inside(boxes, leaders).sum(axis=1))
        cost = cost + PER_OVERLAP * _overlap(boxes, taken) + 10.0 * _outside(boxes, frame)
        others = np.vstack([other.anchors for other in labels if other is not label] or [np.zeros((0, 2))])
        cost = cost + PER_NEARER_OTHER * np.maximum(_away(boxes, label.anchors) - _away(boxes, others), 0.0)
        best = int(np.argmin(cost))
        taken, leaders = np.vstack([taken, boxes[best]]), np.vstack([leaders, lines[best]])
        places[i] = Place(centers[best], anchors[best])
    return [places[i] for i in range(len(labels))]


def _candidates(label: Label) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres round every anchor in rings, their anchors, and the distance of each from its anchor."""
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    unit = np.column_stack([np.cos(angles), np.sin(angles)])
    half = 0.5 * np.array(label.size)
    rings = np.array(RINGS)[:, None, None]
    offsets = (unit * rings + np.sign(np.round(unit, 6)) * half).reshape(-1, 2)
    centers = (label.anchors[:, None, :] + offsets).reshape(-1, 2)
    distance = np.tile(np.repeat(np.array(RINGS), DIRECTIONS), len(label.anchors))
    return centers, np.repeat(label.anchors, len(offsets), axis=0), distance


def _boxes(centers: np.ndarray, size: tuple[float, float]) -> np.ndarray:
    half = 0.5 * np.array(size)
    return np.hstack([centers - half, centers + half])


def _away(boxes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance of each box from the nearest of the points."""
    if not len(points):
        return np.full(len(boxes), np.inf)
    outside = np.maximum(np.maximum(boxes[:, None, :2] - points[None], points[None] - boxes[:, None, 2:]), 0.0)
    return np.hypot(outside[..., 0], outside[..., 1]).min(axis=1)


def _inside(boxes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(boxes, points) bool."""
    x, y = points[:, 0], points[:, 1]
    left, bottom, right, top = boxes.T[:, :, None]
    return (x > left) & (x < right) & (y > bottom) & (y < top)


def _overlap(boxes: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """Area shared with the labels that stand already."""
    low = np.maximum(boxes[:, None, :2], taken[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], taken[None, :, 2:])
    return np.prod(np.maximum(high - low, 0.0), axis=-1).sum(axis=1)


def _outside(boxes: np.ndarray, frame: tuple[float, float, float, float]) -> np.ndarray:
    left, bottom, right, top = frame
    over = [left - boxes[:, 0], bottom - boxes[:, 1], boxes[:, 2] - right, boxes[:, 3] - top]
    return np.sum(np.maximum(over, 0.0), axis=0)
