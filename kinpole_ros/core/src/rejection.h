/*
 * Which markers and poses are not used, and why: the rules that run for every frame.
 *
 * rejection.py has the limits, all verdicts, and the rules that need more than one frame of one
 * body.
 */

#ifndef KINPOLE_REJECTION_H
#define KINPOLE_REJECTION_H

#include "../include/frames.h"

/* The UNUSUAL_BITS of marker `k` of body `b`, whose residual has this square, m^2. */
static inline int
verdict_on_marker(const Frames *f, long long b, long long k, double square)
{
    long long at = b * f->known.width + k;
    int is_doubtful = square > f->known.doubtful[at];
    return (square > f->known.largest[at] ? ODD : 0) | (is_doubtful ? NAME_DOUBTFUL : 0);
}

/* Whether a pose of body `b` is fitted to markers too close together for their noise, while others
   of it are hidden. `spread`, m^2, is the weighted sum of their squared distances from their
   mean. */
static inline int
is_unsteady(const Frames *f, long long b, double spread)
{
    return f->known.spread[b] > f->known.loosest[b] && spread < f->known.loosest[b];
}

/* Finds the poses before the newest two that these show to be off the path of their body. They get
   an `information` of 0, and are added to `wrong` (B). `left_out` (B) gets how many of the newest
   poses may be off it, and cannot be told yet. `turns` of the newest two rows change if they were
   counted from a wrong pose. A body without `jump_scale`, with few poses, or without a pose in the
   newest row only gets a `left_out` of 0. */
void kinpole_follow_paths(const Frames *f);
/* Whether the markers `points` (n), m, of body `b`, all that are seen and at least two, repeat
   those of the row before to the last bit, while measured ones never do: the driver repeats the
   last pose of a body that it has lost. */
int kinpole_is_held(const Frames *f, long long b, const Number *points);
/* Whether marker `k` of `points` (n), m, repeats those of the two rows before, which no measured
   marker of body `b` does: it is lost, and its last place or a constant stands for it. */
int kinpole_is_marker_held(const Frames *f, long long b, const Number *points, long long k);
/* Whether body `b` has a pin that holds since before row `oldest`, and was on it in all frames from
   that row to the newest that have a pose, but for at most two in which it was off by more than
   `n_sigma` standard deviations. */
int kinpole_holds_on_pin(const Frames *f, long long oldest, long long b);
/* Why body `b` has no result for row `now`, one of REASONS; KNOWN if its pose is used. */
int kinpole_reason(const Frames *f, long long now, long long b);

#endif
