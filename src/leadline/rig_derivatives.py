"""Pixels of a rig and their derivatives by its parameters, all analytic.

A pixel's ray after the port is an explicit function of the parameters; the projection of a point is not. The implicit
function theorem turns one into the other: with P(theta) the point of the pixel's ray at a fixed depth behind the port,

    d(pixel)/d(theta) = - d(pixel)/d(point) . dP/d(theta)

(a change along the ray does not matter: d(pixel)/d(point) makes it zero). Everything is in the left camera's frame: the
pupil c, the sight line v (its pinhole direction), the port's normal n at distance e from the pupil, and

    P = c + n (e + sum t_i + w) + a S,   a = v / (v.n) - n,   S = e + sum t_i W_i + w W_o,
    W = 1 / sqrt(m^2 + (m^2 - 1) |a|^2)

with layers (t_i, m_i) and w metres of the outside medium of index m_o.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from enum import StrEnum
from typing import Any

import numpy as np

from leadline.geometry import Camera, LayeredPort
from leadline.rig import Rig, Side
from leadline.samples import Array

SIDES: tuple[Side, Side] = ("left", "right")
_RADIAL = {0: 1, 1: 2, 4: 3, 5: 1, 6: 2, 7: 3}
"""The power of r^2 that each radial coefficient goes with."""


class Medium(StrEnum):
    """Where a board was: in water; in air, the cameras without the housing; in air before the housing's port."""

    WATER = "water"
    AIR = "air"
    AIR_BEHIND_PORT = "air behind the port"


def medium_of(rig: Rig) -> Medium:
    """Where a rig is as it stands: without a port in air, else in what its port says is outside."""
    return Medium.AIR if rig.port is None else Medium.WATER


def port_for(rig: Rig, medium: Medium) -> LayeredPort | None:
    """The port that the light came through, in the left frame. ValueError where the rig has none and needs one."""
    if medium is Medium.AIR:
        return None
    if rig.port is None:
        raise ValueError("the rig has no port")
    return rig.port if medium is Medium.WATER else dataclasses.replace(rig.port, outside_index=1.0)


def project(rig: Rig, side: Side, medium: Medium, points_m: Array) -> tuple[Array, Array]:
    """Points (N, 3), left frame -> pixels (N, 2) of one camera and d(pixel)/d(point) (N, 2, 3)."""
    lens, port = _camera(rig, side), port_for(rig, medium)
    T = rig.T_right_left
    here = points_m if side == "left" else T.apply(points_m)
    if port is None:
        pixels, jacobian = lens.project_with_jacobian(here)
    else:
        pixels, jacobian = (port if side == "left" else port.seen_from(T)).project_with_jacobian(lens, here)
    return pixels, jacobian if side == "left" else jacobian @ T.R


def by_parameters(
    rig: Rig, side: Side, medium: Medium, points_m: Array, pixels: Array, by_point: Array, names: Sequence[str]
) -> Array:
    """d(pixel)/d(parameters) (N, 2, len(names)); names as in the rig file, zero for those without effect.

    points_m (N, 3) left frame, with their pixels (N, 2) and d(pixel)/d(point) (N, 2, 3) from ``project``.
    """
    lens = _camera(rig, side)
    xy = lens.normalise(pixels)
    out = np.zeros((len(pixels), 2, len(names)))
    ray = _Ray(rig, side, port_for(rig, medium), xy, points_m)
    for column, name in enumerate(names):
        part, _, key = name.partition(".")
        if part == side:
            out[:, :, column] = _by_lens(lens, xy, pixels, key)
        elif part in ("T_right_left", "port", "water"):
            moved = ray.moved_by(part, key)
            if moved is not None:
                out[:, :, column] = -np.einsum("nij,nj->ni", by_point, moved)
    return out


def _camera(rig: Rig, side: Side) -> Camera:
    return rig.left if side == "left" else rig.right


def _by_lens(lens: Camera, xy: Array, pixels: Array, key: str) -> Array:
    """d(pixel)/d(one parameter of the lens) (N, 2)."""
    zero, one = np.zeros(len(xy)), np.ones(len(xy))
    match key:
        case "fx_px":
            return np.stack([(pixels[:, 0] - lens.cx) / lens.fx, zero], axis=1)
        case "fy_px":
            return np.stack([zero, (pixels[:, 1] - lens.cy) / lens.fy], axis=1)
        case "cx_px":
            return np.stack([one, zero], axis=1)
        case "cy_px":
            return np.stack([zero, one], axis=1)
    dx, dy = _by_distortion(lens, xy[:, 0], xy[:, 1], _number(key))
    return np.stack([lens.fx * dx, lens.fy * dy], axis=1)


def _by_distortion(lens: Camera, x: Array, y: Array, i: int) -> tuple[Array, Array]:
    """d(distorted x, y)/d(coefficient i), in OpenCV's order (see ``geometry.camera``)."""
    k1, k2, _, _, k3, k4, k5, k6, *_ = lens.distortion + (0.0,) * 12
    r2, zero = x * x + y * y, np.zeros_like(x)
    below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    if i in _RADIAL:
        above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        d = r2 ** _RADIAL[i] / below * (1 if i in (0, 1, 4) else -above / below)
        return x * d, y * d
    return {
        2: (2 * x * y, r2 + 2 * y * y),
        3: (r2 + 2 * x * x, 2 * x * y),
        8: (r2, zero),
        9: (r2**2, zero),
        10: (zero, r2),
        11: (zero, r2**2),
    }[i]


def _number(key: str) -> int:
    match = re.search(r"\[(\d+)\]", key)
    return int(match[1]) if match else 0


class _Ray:
    """The rays of given pixels, and how their points move with a parameter (dP, see the module's text)."""

    def __init__(self, rig: Rig, side: Side, port: LayeredPort | None, xy: Array, points_m: Array) -> None:
        self.side, self.port = side, port
        self.T = rig.T_right_left
        self.sight = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)  # camera's frame
        self.v = self.sight if side == "left" else self.sight @ self.T.R  # left frame
        self.c = np.zeros(3) if side == "left" else -self.T.R.T @ self.T.t_m
        if port is None:
            self.length = np.einsum("ni,ni->n", points_m - self.c, self.v) / np.einsum("ni,ni->n", self.v, self.v)
            return
        self.n: Array = port.normal
        self.forward = self.v @ self.n
        self.a: Array = self.v / self.forward[:, None] - self.n
        self.q2 = np.einsum("ni,ni->n", self.a, self.a)
        self.e = port.distance_m - float(self.n @ self.c)
        self.outside = points_m @ self.n - port.outer_distance_m
        self.stack: list[tuple[Any, float]] = [*port.layers, (self.outside, port.outside_index)]
        self.w: list[Array] = [1.0 / np.sqrt(m * m + (m * m - 1) * self.q2) for _, m in self.stack]
        self.S: Array = self.e + sum(t * w for (t, _), w in zip(self.stack, self.w, strict=True))
        self.along: Array = self.e + sum(t for t, _ in self.stack)
        # dS/d(|a|^2), from dW/d(|a|^2) = -W^3 (m^2 - 1) / 2
        pairs = zip(self.stack, self.w, strict=True)
        self.S_by_q2: Array = sum((-0.5 * t * w**3 * (m * m - 1) for (t, m), w in pairs), np.zeros(len(xy)))

    def moved_by(self, part: str, key: str) -> Array | None:
        """dP/d(parameter) (N, 3), or None where the parameter has no effect on this ray."""
        if part == "T_right_left":
            return None if self.side == "left" else self._by_pose(key)
        if self.port is None or key in ("group_index", "normal[2]"):  # the normal's third follows from its others
            return None
        if part == "water":
            return None if self.port.outside_index == 1.0 else self.a * self._by_index(-1)[:, None]
        return self._by_port(key)

    def _by_port(self, key: str) -> Array:
        i = _number(key)
        match key.split("[", maxsplit=1)[0], key.rpartition(".")[2]:
            case "distance_m", _:
                return self.n + self.a
            case "normal", _:
                dn = np.eye(3)[i]
                dn[2] = -self.n[i] / self.n[2]
                return self._moved(np.zeros(3), np.zeros_like(self.v), dn)
            case "layers", "thickness_m":
                # the water begins later: the point stays, its depth in the water shrinks with the thickness
                moved: Array = self.n + self.a * self.w[i][:, None]
                return moved
            case "layers", "index":
                return self.a * self._by_index(i)[:, None]
        raise ValueError(f"port.{key}: has no derivative")

    def _by_index(self, i: int) -> Array:
        """dS/d(index of layer i): t dW/dm = -t W^3 m (1 + |a|^2)."""
        t, m = self.stack[i]
        out: Array = -t * self.w[i] ** 3 * m * (1 + self.q2)
        return out

    def _by_pose(self, key: str) -> Array:
        i, R, t = _number(key), self.T.R, self.T.t_m
        axis = np.eye(3)[i]
        if key.startswith("t_m"):
            return self._moved(-R.T @ axis, np.zeros_like(self.v), np.zeros(3))
        # R' = exp(axis) R, so R'^T x = R^T (x - axis x x)
        return self._moved(R.T @ np.cross(axis, t), -np.cross(axis, self.sight) @ R, np.zeros(3))

    def _moved(self, dc: Array, dv: Array, dn: Array) -> Array:
        """dP for changes of the pupil (3,), the sight lines (N, 3) and the normal (3,)."""
        if self.port is None:
            moved: Array = dc + self.length[:, None] * dv
            return moved
        forward = self.forward[:, None]
        de = -float(dn @ self.c) - float(self.n @ dc)
        da = dv / forward - self.v * (dv @ self.n + self.v @ dn)[:, None] / forward**2 - dn
        dS = de + self.S_by_q2 * 2 * np.einsum("ni,ni->n", self.a, da)
        out: Array = dc + dn * self.along[:, None] + self.n * de + da * self.S[:, None] + self.a * dS[:, None]
        return out


def point_sensitivity(rig: Rig, points_m: Array, names: Sequence[str]) -> Array:
    """d(triangulated point)/d(parameters) (N, 3, k) at points (N, 3) of the rig's medium; NaN where not seen twice.

    Pixels q of a true point are explained by a rig whose parameters are off by e: the point that fits them best moves
    by S e, S = -(J^T J)^-1 J^T dq/de with J = dq/dpoint of both cameras (implicit function theorem at the least-squares
    triangulation).
    """
    medium = medium_of(rig)
    by_point, by_names = list[Array](), list[Array]()
    seen = np.ones(len(points_m), dtype=bool)
    for side in SIDES:
        pixels, jacobian = project(rig, side, medium, points_m)
        by_point.append(jacobian)
        by_names.append(by_parameters(rig, side, medium, points_m, pixels, jacobian, names))
        seen &= np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(by_names[-1]).all(axis=(1, 2))
    J, moved = np.concatenate(by_point, axis=1), np.concatenate(by_names, axis=1)
    J[~seen], moved[~seen] = np.eye(4, 3), np.nan
    out: Array = -np.linalg.pinv(J) @ moved
    return out
