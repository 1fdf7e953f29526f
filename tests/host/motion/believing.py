"""Beliefs as tests need them: of given parcels at given poses, at rest and well known."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.tracker import Parcel
from mdms_model.arrays import Floats


def beliefs(
    poses: Mapping[str, Floats], parcels: Iterable[Parcel], **others: Any
) -> dict[str, Belief]:
    """The beliefs of those of the parcels that have a pose."""
    at_rest = {"twist": np.zeros(3), "covariance": np.zeros((3, 3)), **others}
    return {
        parcel.name: Belief(parcel.name, parcel.footprint, poses[parcel.name], **at_rest)
        for parcel in parcels
        if parcel.name in poses
    }
