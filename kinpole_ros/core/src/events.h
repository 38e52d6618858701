/*
 * Events: instants at which the position, the velocity or the acceleration steps, as at an impact.
 *
 * 1. Screening. One model leaves the residual P x of the samples x, with the inverse P of its
 *    covariance. A step b, half a sample before each sample, has the product b' P x, and its size
 *    is estimated as b' P x / b' P b. The products of all steps are cumulative sums of P x. They
 *    give the evidence that a step of each order at each place would add, with its shift in time
 *    (`screen_window`). This is done with the most probable model.
 * 2. Evaluation. The best candidate becomes columns of the regression: the step, its shift in time,
 *    and a step of the next derivative, because the model without an event is rough and shows the
 *    order badly. All models are evaluated with them (`add_event`, `evaluate_models`). If segments
 *    (segments.c) show another event near the instant, it is a set of its own. More events in a
 *    window are left to segments.
 * 3. Other places of an event, by their evidence, add to the covariance (`add_place_covariance`).
 *
 * `search_events` returns the sets, and `differentiate` averages all models with all of them. The
 * evidence of a set less that of the first set, without events, says how sure its events are.
 *
 * window_events.c lists the events of a window that are reported, with the same screens and sets.
 */

#ifndef KINPOLE_EVENTS_H
#define KINPOLE_EVENTS_H

#include "screens.h"
#include "segments.h"

/* Log evidence that a candidate has to add in the screening: below it the prior wins. */
#define MIN_GAIN 8.0

/* Return the log prior odds of an event at one place of `count` samples, with one order. */
PRIVATE double log_event_prior(long long count);

/* Make a set with the columns of an event besides those of `base`: its step, a step of the
   derivative below, for its shift in time, and of so many of those above, `following`. `screens`
   have the columns of `base`. Samples are means of `block` cells. The set is laid out at `data` for
   so many `orders`; returns the end of its memory. */
PRIVATE char *add_event(const Models *m, const Set *base, const Screens *screens,
                        const Candidate *event, int following, long long orders, long long block,
                        char *data, Set *set);

/* Search a window for events, and evaluate the models with each. The first of `sets` (MAX_SETS) has
   no event, and is evaluated already. Samples are means of `block` cells. Appends a set for each
   event to `sets`, and adds to their `number`. Without a likely event nothing changes, and `d`
   neither; with one `d` is the division of the window. Returns DONE or NO_MEMORY. */
PRIVATE int search_events(Call *call, const Models *m, const Stencils *stencils, const Samples *s,
                          const Work *w, long long block, Set *sets, int *number, Division *d);

#endif
