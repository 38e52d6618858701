"""Trial: windows in two parts."""

import os
from math import lgamma, log, pi

import numpy as np

from kinpole_ros.derivatives._evidence import KNOWN, Found, evidence_of
from kinpole_ros.derivatives._fast import derive
from kinpole_ros.derivatives._models import _AMPLITUDES, _FLAT, _LEAST, modes_of, stencils_of

FLAT = log(_FLAT * _LEAST * 10.0 ** (_AMPLITUDES - 1))
NEWER = tuple(float(x) for x in os.environ.get('NEWER', '.30,.58').split(',') if x)
PRIOR = float(os.environ.get('PRIOR', '.5'))
SHARED = int(os.environ.get('SHARED', '0'))
STAT = [0, 0]


def total(modes, samples):
    ev = evidence_of(modes, samples, float(len(samples))).evidence
    n = len(samples)
    out = []
    for c, k in enumerate((1, 2)):
        num = KNOWN + n * k
        const = (
            lgamma(num / 2)
            - lgamma(KNOWN / 2)
            + KNOWN / 2 * log(KNOWN)
            - n * k / 2 * log(pi)
            - num / 2 * log(num)
        )
        e = ev[:, c]
        m = e.max(axis=0)
        out.append(m + np.log(np.exp(e - m).sum(axis=0)) + const - 2 * FLAT * k)
    return np.array(out)


def derive_parts(window, samples):
    size, at, block, orders, exact = window
    whole = derive(modes_of(size, block, exact), stencils_of(*window), samples, float(size))
    if exact:
        return whole
    instant = at + (size - 1) / 2
    founds = [whole]
    logs = [total(modes_of(size, block), samples) + 0.0]
    lp = log(PRIOR / len(NEWER) / (1 - PRIOR)) if NEWER else 0
    for share in NEWER:
        newer = round(share * size)
        cut = size - newer
        if newer < 8 or cut < 8:
            continue
        old, new = np.ascontiguousarray(samples[:cut]), np.ascontiguousarray(samples[cut:])
        t = total(modes_of(cut, block), old) + total(modes_of(newer, block), new)
        if instant >= cut - 0.5:
            own, w = new, (newer, instant - cut - (newer - 1) / 2, block, orders, False)
        else:
            own, w = old, (cut, instant - (cut - 1) / 2, block, orders, False)
        founds.append(derive(modes_of(len(own), block), stencils_of(*w), own, float(len(own))))
        logs.append(t + (lp / 2 if SHARED else lp))
    logs = np.array(logs)
    if SHARED:
        logs = np.repeat(logs.sum(axis=1)[:, None], 2, axis=1)
    p = np.exp(logs - logs.max(axis=0))
    p /= p.sum(axis=0)  # (F,2,S)
    STAT[0] += p.shape[2]
    STAT[1] += (p[0] < 0.999).any(axis=0).sum()
    sig = [0, 1, 1]
    mean = sum(f.mean * q[sig] for f, q in zip(founds, p))
    cov = np.zeros_like(whole.covariance)
    freedom = 0
    for f, q in zip(founds, p):
        off = f.mean - mean
        sq = off[:, None] * off[None]  # K K 3 S
        sq = np.stack((sq[:, :, 0], (sq[:, :, 1] + sq[:, :, 2]) / 2), axis=2)
        cov += q * (f.covariance + sq)
        freedom = freedom + q * f.freedom
    return Found(mean, cov, freedom)
