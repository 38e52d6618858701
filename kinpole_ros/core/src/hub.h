/*
 * The hub of a body: the point that it turns about.
 *
 * With the angle a and the position z, the point c of the body is at z + c exp(i a). The path of a
 * pin, of the hub of a wheel, or of an arm's end is a low polynomial, where that of any other point
 * has the arcs and the events of the turning. Poles are the same for all points of a body. So the
 * position is that of the hub, if a polynomial and a hub explain the samples with more evidence
 * than all models of the position without.
 *
 * The arm c follows from linear regression of z on exp(i a) and the polynomial; with a higher
 * degree it is less biased. The noise of the hub is that of z, and |c| times that of the angle. The
 * latter is taken to be independent of the angle.
 */

#ifndef KINPOLE_HUB_H
#define KINPOLE_HUB_H

#include "mean.h"

/* A hub at `arm` from the position while the angle is 0: the degree of its path, the variance of
   its noise over that of the position (0 without a hub), the squares of what a path leaves of
   turning, and of these the part that is noise, the log evidence, and the turning that is on its
   path at the instant. */
typedef struct {
    int degree;
    double growth, turning, noise, value;
    Number arm, path[MAX_ORDERS];
} Hub;

/* Find a hub with more evidence than `least`; `s` then has its position. Angles are in units of
   `radians`. Returns NO_MEMORY or DONE. */
PRIVATE int find_hub(Call *call, const Stencils *by, double radians, double least, Samples *s,
                     Hub *hub);

/* Replace the position by that of a hub, which `moved` has in units of its noise, and add the
   covariance of its arm. */
PRIVATE void take_hub(const Hub *hub, const Estimate *moved, double radians, long long orders,
                      Estimate *estimate);

#endif
