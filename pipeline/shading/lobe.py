"""Mirrored light as a sum over the lobe's half vectors, each looked up in a narrower prefiltered level.

Split sum blurs the environment alike in all directions; a real lobe is stretched at grazing view, and each facet
polarises along its own plane of incidence. Here K facets (Gauss rings x azimuths in the distribution's own measure)
carry most of the roughness, and the level looked up the rest: slopes' variances add, alpha^2 = spread^2 + rest^2.
The result is relative to the lobe's albedo, which stays the table's (`splitsum`).

Gradients: facets move rigidly with the normal, the weights are constants (they are normalised).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray

from pipeline.kernels.compiling import kernel
from pipeline.optics import fresnel, microfacet
from pipeline.optics.model_names import MIRRORS
from pipeline.optics.stokes import surface_pattern

from . import limits
from .cube_kernels import MATH, add, direction_gradient, fetch, texels
from .facet_kernels import masking, polarisation, reflectance
from .prefilter import LightField
from .shade_kernels import chunks, level_below, surface_point
from .splitsum import half_vectors

# Share of the width left to the looked-up level, by number of rings: about the facets' spacing.
REST = (0.5, 0.4, 0.3, 0.2)

_ONE, _TWO, _ZERO = np.float32(1), np.float32(2), np.float32(0)
_TINY = np.float32(1e-6)
_MIN_ROUGHNESS = np.float32(limits.MIN_ROUGHNESS)


@lru_cache(maxsize=16)
def pattern(mirror: str, lobe: str) -> tuple[NDArray[np.float32], float, float]:
    """(facets [K, 4]: cos and sin of azimuth, tan/alpha, weight; spread/alpha; level's roughness / roughness)."""
    layout = MIRRORS[mirror]
    assert layout is not None, "the split sum has no facets"
    rings, azimuths = layout
    tan, _, w = half_vectors(1.0, lobe, rings, azimuths)
    rest = REST[rings - 1]
    # Every other ring is turned by half a step; the pattern is symmetric about the plane of incidence.
    turn = (np.arange(azimuths) + 0.5 * (np.arange(rings)[:, None] % 2)) * (2 * np.pi / azimuths)
    columns = (np.cos(turn), np.sin(turn), tan[:, None] * np.ones_like(turn), w[:, None] / azimuths + 0 * turn)
    facets = np.stack([c.ravel() for c in columns], -1).astype(np.float32)
    return facets, float(np.sqrt(1 - rest * rest)), float(np.sqrt(rest))


def plain(
    normal: torch.Tensor,
    view: torch.Tensor,
    roughness: torch.Tensor,
    eta: torch.Tensor,
    frame_x: torch.Tensor,
    frame_y: torch.Tensor,
    light: LightField,
    mirror: str,
) -> tuple[torch.Tensor, torch.Tensor]:
    """(mirrored light [P, 3], its (s1, s2) with sign reversed [P, 2, 3]), both over the lobe's albedo: the definition.

    roughness and eta inside `limits`. Points whose every facet is hidden see along the mirror direction, unpolarised.
    """
    facets, spread, rest = pattern(mirror, light.lobe)
    facing = (normal * view).sum(-1, keepdim=True).detach()
    fixed = normal.detach()
    # Tangents about the view's own plane of incidence; at normal incidence any will do.
    along = view.detach() - facing * fixed
    other = torch.zeros_like(fixed).scatter(1, fixed.abs().argmin(1, keepdim=True), 1.0)
    other = other - (other * fixed).sum(-1, keepdim=True) * fixed
    along = torch.where((along * along).sum(-1, keepdim=True) > 1e-6, along, other)
    along = along / along.norm(dim=-1, keepdim=True)
    across = torch.linalg.cross(fixed, along)
    moved = normal - fixed
    alpha = roughness * roughness
    # One axis of facets before that of points: [K, P, 3].
    cosine, sine, slope, share = torch.as_tensor(facets, device=normal.device).to(normal.dtype).T[..., None]
    tan = (slope * spread * alpha)[..., None]
    h = (tan * (cosine[..., None] * along + sine[..., None] * across) + fixed) / torch.sqrt(1 + tan * tan)
    h = h + moved * (fixed * h).sum(-1, keepdim=True).detach() - fixed * (moved * h.detach()).sum(-1, keepdim=True)
    vh = (view * h).sum(-1)
    out = 2 * vh[..., None] * h - view
    with torch.no_grad():
        nl, nh = (fixed * out).sum(-1), (fixed * h).sum(-1)
        seen = (vh > _TINY.item()) & (nl > _TINY.item())
        shadow = microfacet.masking(torch.where(seen, nl, 1.0), alpha, light.lobe)
        reflected = fresnel.reflectance(torch.where(seen, vh, 1.0), eta)
        weight = torch.where(seen, shadow * vh / nh * share * reflected, 0.0)
    blurred = (roughness * rest).clamp_min(limits.MIN_ROUGHNESS)
    value = light.mirrored(out.reshape(-1, 3), blurred.expand(len(out), -1).reshape(-1)).reshape(out.shape)
    cos2, sin2 = surface_pattern(h, frame_x, frame_y)
    square = (h * frame_x).sum(-1) ** 2 + (h * frame_y).sum(-1) ** 2
    polarised = fresnel.specular_polarisation(torch.where(seen, vh, 1.0), square, eta)[..., None] * value
    samples = torch.cat((value, cos2[..., None] * polarised, sin2[..., None] * polarised), dim=-1)
    total = weight.sum(0)
    hidden = total <= 0
    weight = weight / torch.where(hidden, 1.0, total)
    result = (weight[..., None] * samples).sum(0)
    lost = 2 * (normal * view).sum(-1, keepdim=True) * normal - view
    straight = light.mirrored(lost, blurred)
    return torch.where(hidden[:, None], straight, result[:, :3]), result[:, 3:].reshape(-1, 2, 3)


def mirrored(
    normal: torch.Tensor,
    view: torch.Tensor,
    roughness: torch.Tensor,
    ior: torch.Tensor,
    frame_x: torch.Tensor,
    frame_y: torch.Tensor,
    light: LightField,
    mirror: str,
) -> tuple[torch.Tensor, torch.Tensor]:
    """`plain` as a fused kernel: float32, CPU; clamps roughness and ior itself."""
    return _Lobe.apply(light, mirror, normal, view, roughness, ior, frame_x, frame_y, light.packed)


class _Lobe(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, light: LightField, mirror: str, *tensors: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        ctx.arrays = [x.detach().contiguous().numpy() for x in tensors]
        ctx.rest = (*light.tables()[:5], *pattern(mirror, light.lobe), light.lobe == "ggx")
        points = len(ctx.arrays[0])
        value, turned = torch.empty(points, 3), torch.empty(points, 2, 3)
        kernel: Any = _forward
        kernel(*ctx.arrays, *ctx.rest, value.numpy(), turned.numpy())
        return value, turned

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        normal, view, roughness, ior, _, _, packed = ctx.arrays
        tables = torch.zeros(chunks(len(normal)), *packed.shape)
        new = [torch.empty(x.shape) for x in (normal, view, roughness, ior)]
        kernel: Any = _backward
        kernel(
            *ctx.arrays, *ctx.rest, *(g.contiguous().numpy() for g in gradients), *(x.numpy() for x in new), tables.numpy()
        )  # fmt: skip
        return (None, None, *new, None, None, tables.sum(0))


@kernel(fastmath=MATH, error_model="numpy")
def _facets(n, v, f, r, e, facets, spread, ggx, out):
    """Fill out [K, 4] with half vectors and normalised weights; returns whether any facet is seen.

    n, v: tuples; f: the cosine between them.
    """
    n0, n1, n2 = n
    v0, v1, v2 = v
    t0, t1, t2 = v0 - f * n0, v1 - f * n1, v2 - f * n2
    square = t0 * t0 + t1 * t1 + t2 * t2
    if square <= _TINY:
        a0, a1, a2 = abs(n0), abs(n1), abs(n2)
        t0, t1, t2 = _ZERO, _ZERO, _ZERO
        if a0 <= a1 and a0 <= a2:
            t0, g = _ONE, n0
        elif a1 <= a2:
            t1, g = _ONE, n1
        else:
            t2, g = _ONE, n2
        t0, t1, t2 = t0 - g * n0, t1 - g * n1, t2 - g * n2
        square = t0 * t0 + t1 * t1 + t2 * t2
    s = _ONE / np.sqrt(max(square, _TINY))
    t0, t1, t2 = t0 * s, t1 * s, t2 * s
    b0, b1, b2 = n1 * t2 - n2 * t1, n2 * t0 - n0 * t2, n0 * t1 - n1 * t0
    alpha = r * r
    total = _ZERO
    for k in range(len(facets)):
        tan = facets[k, 2] * spread * alpha
        nh = _ONE / np.sqrt(_ONE + tan * tan)
        ct, st = facets[k, 0] * tan, facets[k, 1] * tan
        h0 = (ct * t0 + st * b0 + n0) * nh
        h1 = (ct * t1 + st * b1 + n1) * nh
        h2 = (ct * t2 + st * b2 + n2) * nh
        vh = v0 * h0 + v1 * h1 + v2 * h2
        nl = _TWO * vh * (n0 * h0 + n1 * h1 + n2 * h2) - f
        w = _ZERO
        if vh > _TINY and nl > _TINY:
            w = masking(nl, alpha * alpha, ggx) * vh / nh * facets[k, 3] * reflectance(vh, e)
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = h0, h1, h2, w
        total += w
    if total > _ZERO:
        for k in range(len(facets)):
            out[k, 3] /= total
        return True
    return False


@kernel(parallel=True, fastmath=MATH, error_model="numpy")
def _forward(
    normal, view, roughness, ior, frame_x, frame_y, packed, nodes, sizes, starts, index, bases,
    facets, spread, rest, ggx, value, turned,
):  # fmt: skip
    spread, rest = np.float32(spread), np.float32(rest)
    parts = max(1, len(normal) // 256)
    for part in prange(parts):
        h = np.empty((len(facets), 4), np.float32)
        for p in range(len(normal) * part // parts, len(normal) * (part + 1) // parts):
            n, v, facing, r, e = surface_point(normal, view, roughness, ior, p)
            level, fraction, _ = level_below(max(r * rest, _MIN_ROUGHNESS), nodes)
            for k in range(3):
                value[p, k], turned[p, 0, k], turned[p, 1, k] = _ZERO, _ZERO, _ZERO
            seen = _facets(n, v, facing, r, e, facets, spread, ggx, h)
            for s in range(len(facets) if seen else 1):
                h0, h1, h2, w = h[s, 0], h[s, 1], h[s, 2], h[s, 3]
                if not seen:
                    h0, h1, h2, w = n[0], n[1], n[2], _ONE
                if w <= _ZERO:
                    continue
                vh = v[0] * h0 + v[1] * h1 + v[2] * h2
                l0, l1, l2 = _TWO * vh * h0 - v[0], _TWO * vh * h1 - v[1], _TWO * vh * h2 - v[2]
                lower = texels(l0, l1, l2, sizes[level], index, bases[level])
                upper = texels(l0, l1, l2, sizes[level + 1], index, bases[level + 1])
                hx = h0 * frame_x[p, 0] + h1 * frame_x[p, 1] + h2 * frame_x[p, 2]
                hy = h0 * frame_y[p, 0] + h1 * frame_y[p, 1] + h2 * frame_y[p, 2]
                beta = polarisation(vh, hx * hx + hy * hy, e)[0] if seen else _ZERO
                cos2, sin2 = (hx - hy) * (hx + hy) * beta, _TWO * hx * hy * beta
                for k in range(3):
                    below = fetch(packed, starts[level], lower, k)[0]
                    above = fetch(packed, starts[level + 1], upper, k)[0]
                    light = w * (below + (above - below) * fraction)
                    value[p, k] += light
                    turned[p, 0, k] += cos2 * light
                    turned[p, 1, k] += sin2 * light


@kernel(parallel=True, fastmath=MATH, error_model="numpy")
def _backward(
    normal, view, roughness, ior, frame_x, frame_y, packed, nodes, sizes, starts, index, bases,
    facets, spread, rest, ggx, g_value, g_turned, g_normal, g_view, g_roughness, g_ior, g_packed,
):  # fmt: skip
    spread, rest = np.float32(spread), np.float32(rest)
    count, parts = len(normal), len(g_packed)
    for part in prange(parts):
        h = np.empty((len(facets), 4), np.float32)
        table = g_packed[part]
        for p in range(count * part // parts, count * (part + 1) // parts):
            n, v, facing, r, e = surface_point(normal, view, roughness, ior, p)
            level, fraction, slope = level_below(max(r * rest, _MIN_ROUGHNESS), nodes)
            free = _ONE if r * rest >= _MIN_ROUGHNESS else _ZERO
            gn0, gn1, gn2, gv0, gv1, gv2, gr, ge = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
            seen = _facets(n, v, facing, r, e, facets, spread, ggx, h)
            for s in range(len(facets) if seen else 1):
                h0, h1, h2, w = h[s, 0], h[s, 1], h[s, 2], h[s, 3]
                if not seen:
                    h0, h1, h2, w = n[0], n[1], n[2], _ONE
                if w <= _ZERO:
                    continue
                vh = v[0] * h0 + v[1] * h1 + v[2] * h2
                l0, l1, l2 = _TWO * vh * h0 - v[0], _TWO * vh * h1 - v[1], _TWO * vh * h2 - v[2]
                lower = texels(l0, l1, l2, sizes[level], index, bases[level])
                upper = texels(l0, l1, l2, sizes[level + 1], index, bases[level + 1])
                hx = h0 * frame_x[p, 0] + h1 * frame_x[p, 1] + h2 * frame_x[p, 2]
                hy = h0 * frame_y[p, 0] + h1 * frame_y[p, 1] + h2 * frame_y[p, 2]
                beta, beta_c, beta_s, beta_e = polarisation(vh, hx * hx + hy * hy, e)
                if not seen:
                    beta, beta_c, beta_s, beta_e = _ZERO, _ZERO, _ZERO, _ZERO
                cos2, sin2 = (hx - hy) * (hx + hy), _TWO * hx * hy
                g_cos2, g_sin2 = _ZERO, _ZERO
                gs_l, gt_l, gs_u, gt_u, g_fraction = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
                for k in range(3):
                    below, bs, bt = fetch(packed, starts[level], lower, k)
                    above, us, ut = fetch(packed, starts[level + 1], upper, k)
                    light = w * (below + (above - below) * fraction)
                    g1, g2 = g_turned[p, 0, k], g_turned[p, 1, k]
                    g_cos2 += g1 * light
                    g_sin2 += g2 * light
                    g = w * (g_value[p, k] + beta * (cos2 * g1 + sin2 * g2))
                    g_fraction += g * (above - below)
                    gb, gu = g * (_ONE - fraction), g * fraction
                    gs_l += gb * bs
                    gt_l += gb * bt
                    gs_u += gu * us
                    gt_u += gu * ut
                    add(table, starts[level], lower, k, gb)
                    add(table, starts[level + 1], upper, k, gu)
                a0, a1, a2 = direction_gradient(lower, sizes[level], gs_l, gt_l)
                b0, b1, b2 = direction_gradient(upper, sizes[level + 1], gs_u, gt_u)
                a0, a1, a2 = a0 + b0, a1 + b1, a2 + b2
                g_beta = g_cos2 * cos2 + g_sin2 * sin2
                g_square = g_beta * beta_s
                g_x = _TWO * (beta * (g_cos2 * hx + g_sin2 * hy) + g_square * hx)
                g_y = _TWO * (beta * (g_sin2 * hx - g_cos2 * hy) + g_square * hy)
                g_vh = _TWO * (h0 * a0 + h1 * a1 + h2 * a2) + g_beta * beta_c
                gh0 = _TWO * vh * a0 + g_vh * v[0] + g_x * frame_x[p, 0] + g_y * frame_y[p, 0]
                gh1 = _TWO * vh * a1 + g_vh * v[1] + g_x * frame_x[p, 1] + g_y * frame_y[p, 1]
                gh2 = _TWO * vh * a2 + g_vh * v[2] + g_x * frame_x[p, 2] + g_y * frame_y[p, 2]
                gv0 += g_vh * h0 - a0
                gv1 += g_vh * h1 - a1
                gv2 += g_vh * h2 - a2
                ge += g_beta * beta_e
                gr += g_fraction * slope * rest * free
                if seen:
                    # Rigid: dh = dn (n.h) - n (dn.h); and h tilts with alpha along nh (direction - tan nh h).
                    nh = n[0] * h0 + n[1] * h1 + n[2] * h2
                    ng = n[0] * gh0 + n[1] * gh1 + n[2] * gh2
                    gn0 += nh * gh0 - ng * h0
                    gn1 += nh * gh1 - ng * h1
                    gn2 += nh * gh2 - ng * h2
                    steep = facets[s, 2] * spread
                    tan = steep * r * r
                    inverse = _ONE / max(tan, _TINY)
                    hg = h0 * gh0 + h1 * gh1 + h2 * gh2
                    gr += ((hg / nh - ng) * inverse * nh - tan * nh * nh * hg) * steep * _TWO * r
                else:
                    gn0 += gh0
                    gn1 += gh1
                    gn2 += gh2
            g_normal[p, 0], g_normal[p, 1], g_normal[p, 2] = gn0, gn1, gn2
            g_view[p, 0], g_view[p, 1], g_view[p, 2] = gv0, gv1, gv2
            g_roughness[p], g_ior[p] = gr, ge
