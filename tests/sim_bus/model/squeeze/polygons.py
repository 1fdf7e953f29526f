"""Polygons to squeeze."""

import numpy as np
from hypothesis import strategies as st

RECTANGLE = np.array([[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]])
SQUARE = RECTANGLE * [0.5, 1.0]
TRIANGLE = np.array([[-0.2, -0.17], [0.2, -0.17], [0.02, 0.19]])
IRREGULAR = np.array([[-0.18, -0.15], [0.2, -0.12], [0.17, 0.1], [-0.02, 0.2], [-0.2, 0.05]])


def regular(count):
    turns = np.arange(count) * 2 * np.pi / count
    return np.column_stack([np.cos(turns), np.sin(turns)])


@st.composite
def polygons(draw, most=8):
    """Convex, with corners on an ellipse that keep apart."""
    count = draw(st.integers(3, most))
    gaps = np.array(draw(st.lists(st.floats(0.5, 1.5), min_size=count, max_size=count)))
    turns = np.cumsum(gaps) / gaps.sum() * 2 * np.pi
    ratio = draw(st.floats(0.6, 1.0))
    return np.column_stack([np.cos(turns), ratio * np.sin(turns)])
