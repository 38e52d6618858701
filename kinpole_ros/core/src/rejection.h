/*
 * Which markers and poses are not used, and why: the rules that run for every frame.
 *
 * rejection.py has the limits, all verdicts, and the rules that need more than one frame of one
 * body.
 */

#ifndef KINPOLE_REJECTION_H
#define KINPOLE_REJECTION_H

#include "../include/codes.h"
#include "../include/frames.h"

/* The verdict on marker `k` of body `b`, whose residual has this square. */
static inline int
verdict_on_marker(const Frames *f, long long b, long long k, double square)
{
    long long at = b * f->known.width + k;
    int is_doubtful = square > f->known.doubtful[at];
    return (square > f->known.largest[at] ? ODD : 0) | (is_doubtful ? NAME_DOUBTFUL : 0);
}

/* Whether a pose is fitted to markers too close together for their noise, of this spread, while
   others of the body are hidden. */
static inline int
is_unsteady(const Frames *f, long long b, double spread)
{
    return f->known.spread[b] > f->known.loosest[b] && spread < f->known.loosest[b];
}

/* Leaves out the poses that the newest row shows to be off their paths; see `wrong` and
   `newest`. */
void kinpole_follow_paths(const Frames *f);
/* Whether the markers (n,) of body `b` are held by the tracker, which lost it. */
int kinpole_is_held(const Frames *f, long long b, const Number *points);
/* Whether marker `k` of them is. */
int kinpole_is_marker_held(const Frames *f, long long b, const Number *points, long long k);
/* Whether a body was on its pin in all frames from row `oldest` on, but for outliers. */
int kinpole_holds_on_pin(const Frames *f, long long oldest, long long b);
/* Why a body has no result for row `now`, as far as its pose says. */
int kinpole_reason(const Frames *f, long long now, long long b);

#endif
