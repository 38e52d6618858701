/*
 * The events of a window: all that its samples show, each beside the others.
 *
 * Events are added one by one as columns of the models of events.h, the likeliest first. Each is
 * screened by models that are too rough, because it is still missing: so its best places are tried,
 * and the likeliest models with it screen once more. Then each event is found again beside all
 * others. The log odds of an event are the log evidence of all models with it and the others, less
 * that without it, and its prior.
 */

#ifndef KINPOLE_WINDOW_EVENTS_H
#define KINPOLE_WINDOW_EVENTS_H

#include "events.h"

/* List the events of a window that are at most `radius` from the instant `at`, samples after the
   first, and a little farther, in `event` and `events` of `out`. Samples are means of `block`
   cells, but places are in samples. `none` is the set without events, which is evaluated. Returns
   DONE or NO_MEMORY. */
PRIVATE int find_window_events(Call *call, const Models *m, const Samples *s, const Work *w,
                               long long block, const Set *none, double at, double radius,
                               Estimate *out);

#endif
