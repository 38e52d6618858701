/*
 * Events: instants at which the position, the velocity or the acceleration steps, as at an impact.
 *
 * 1. Screening. One model leaves the residual P x of the samples x, with the inverse P of its
 *    covariance. A step b, half a sample before each sample, has the product b' P x, and its size
 *    is estimated as b' P x / b' P b. The products of all steps are cumulative sums of P x. They
 *    give the squares that a step of each order at each place explains (`screen_window`). This is
 *    done with the most probable model.
 * 2. Evaluation. The best candidate, if it explains what an event costs, becomes columns of the
 *    regression: the step, its shift in time, and a step of the next derivative, up to that of
 *    acceleration, because the model without an event is rough and shows the order badly. All
 *    models are evaluated with them (`add_event`, `evaluate_models`). More events in a window are
 *    left to segments (segments.c).
 * 3. Other places of an event, by their evidence, add to the covariance (`add_place_covariance`).
 *
 * `search_events` adds a set with the event to that without, and `differentiate` averages all
 * models with both of them. The evidence of the one less that of the other says how sure the event
 * is.
 *
 * change_points.c finds the events that are reported. It has polynomials instead of these models,
 * and excludes what only looks like an event. Both have the same columns of steps and nothing more.
 */

#ifndef KINPOLE_EVENTS_H
#define KINPOLE_EVENTS_H

#include "screens.h"

/* Search a window for an event, and evaluate the models with it. The first of `sets` (MAX_SETS) has
   none, and is evaluated already. Samples are means of `block` cells. With a likely event the next
   set has it, and the `number` of sets is 1 more. Returns DONE or NO_MEMORY. */
PRIVATE int search_events(Call *call, const Models *m, const Stencils *stencils, const Samples *s,
                          const Work *w, long long block, Set *sets, int *number);

#endif
