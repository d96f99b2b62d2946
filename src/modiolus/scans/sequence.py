"""Sequences in time: frame by frame, each begun where the one before ended, and smoothed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from ..errors import InputError, SolveError
from ..fitting.register import Registration
from ..mechanics.face import Face
from ..progress import Report
from .identify import Identification, identify, settle
from .target import Target
from .unknown import Unknown

__all__ = ["Timed", "follow", "smoothed"]

Array = NDArray[np.float64]


class Timed(Protocol):
    """What was measured at a time."""

    @property
    def time(self) -> float:
        """In seconds."""

    def target(self) -> Target:
        """Return what is to be matched.

        Raises
        ------
        InputError, SolveError
            This frame cannot be used, whatever the others are.
        """


Frame = TypeVar("Frame", bound=Timed)
Found = Identification | InputError | SolveError


def follow(
    face: Face,
    frames: Sequence[Frame],
    unknowns: Sequence[Unknown],
    span: float = 0.0,
    report: Report | None = None,
) -> Iterator[tuple[Frame, Found]]:
    """Identify frame by frame, each from the state of the one before.

    Parameters
    ----------
    face : Face
    frames : sequence of Frame
        In the order of time.
    unknowns : sequence of Unknown
    span : float
        See `smoothed`; 0 leaves every frame by itself.
    report : callable, optional
        Called with the share of the frames that are done and a message.

    Yields
    ------
    frame, found
        What was found, or why the frame was not met.
    """
    rounds = 2 if span > 0.0 else 1

    def told(done: float, text: str) -> None:
        if report is not None:
            report(done / (rounds * len(frames)), text)

    if span == 0.0:
        yield from _alone(face, frames, unknowns, told)
        return
    faults: dict[int, Found] = {}
    # Without the states: there may be many frames.
    met: dict[int, tuple[Array, Array, Registration]] = {}
    for number, (_, found) in enumerate(_alone(face, frames, unknowns, told)):
        if isinstance(found, Identification):
            met[number] = np.array(list(found.values.values())), found.covariance, found.pose
        else:
            faults[number] = found
    times = np.array([frames[number].time for number in met])
    values, covariances = (np.array([item[part] for item in met.values()]) for part in (0, 1))
    course = dict(zip(met, smoothed(times, values, covariances, unknowns, span), strict=True))
    latest: Identification | None = None
    for number, frame in enumerate(frames):
        told(len(frames) + number, "smoothed")
        if number in faults:
            yield frame, faults[number]
            continue
        pose = met[number][2]
        try:
            latest = settle(face, frame.target(), unknowns, course[number], pose, latest)
        except SolveError as error:
            yield frame, error
        else:
            yield frame, latest


def _alone(
    face: Face, frames: Sequence[Frame], unknowns: Sequence[Unknown], report: Report
) -> Iterator[tuple[Frame, Found]]:
    """Identify frame by frame; the report is of the frames done."""
    latest: Identification | None = None
    for number, frame in enumerate(frames):

        def told(share: float, text: str, number: int = number) -> None:
            report(number + share, text)

        try:
            latest = identify(face, frame.target(), unknowns, start=latest, report=told)
        except (InputError, SolveError) as error:
            yield frame, error
        else:
            yield frame, latest


def smoothed(
    times: Array, values: Array, covariances: Array, unknowns: Sequence[Unknown], span: float
) -> Array:
    """Weigh what every frame tells of the unknowns against their changes in time.

    Minimised over all frames together, so that nothing lags behind, is::

        Σ_t (q_t - p_t)ᵀ C_t⁻¹ (q_t - p_t) + span Σ_t Σ_k ((q_t+1,k - q_t,k) / s_k)² / Δt

    with what was found ``p`` and its covariance ``C``: the most likely course of unknowns that
    wander at random, in a time of ``span`` by about their scales ``s``.

    Parameters
    ----------
    times : (n,) array
        In seconds, ascending.
    values : (n, k) array
        Found in each frame by itself.
    covariances : (n, k, k) array
        Theirs.
    unknowns : sequence of k Unknown
    span : float
        In seconds.

    Returns
    -------
    (n, k) array
        Within the bounds of the unknowns.
    """
    if len(values) < 2:
        return values
    n, k = values.shape
    scales = np.array([u.scale for u in unknowns])
    known = np.linalg.inv(covariances / np.outer(scales, scales))
    stiff = span / np.diff(times)
    joined = np.zeros(n)
    joined[:-1] += stiff
    joined[1:] += stiff
    known_here = known + joined[:, None, None] * np.eye(k)
    # Upper diagonals of a matrix of blocks, as LAPACK stores them: row k holds the main one.
    bands = np.zeros((k + 1, n * k))
    for i in range(k):
        for j in range(i, k):
            bands[k - (j - i), j::k] = known_here[:, i, j]
    bands[0, k:] = np.repeat(-stiff, k)
    right = np.einsum("tij,tj->ti", known, values / scales).ravel()
    found = solveh_banded(bands, right).reshape(n, k) * scales
    return np.asarray(np.clip(found, [u.low for u in unknowns], [u.high for u in unknowns]))
