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

/* A hub. Turning is exp(i angle). The arm and its errors are those of paths MORE_DEGREES higher. */
typedef struct {
    int degree;              /* of the polynomial that is its path */
    double growth;           /* variance of its noise over that of the position; 0 without a hub */
    double turning;          /* sum of squares of what a path leaves of turning */
    double noise;            /* the part of `turning` that is noise of the angle */
    double value;            /* log evidence */
    Number arm;              /* from the position to the hub while the angle is 0 */
    Number path[MAX_ORDERS]; /* derivatives at the instant of the path of turning */
} Hub;

/* Find a hub of the samples with more log evidence than `least`, that of all models of the position
   without. If there is one, the position in `s` becomes that of the hub, in units of its noise, in
   memory that the next call uses again; otherwise `growth` is 0, and `s` stays. `radians` is the
   unit of the angle. Returns NO_MEMORY or DONE. */
PRIVATE int find_hub(Call *call, const Stencils *stencils, double radians, double least,
                     Samples *s, Hub *hub);

/* Replace the position in `estimate` by that of a hub, which `moved` has in units of its noise, and
   add the covariance of its arm. `orders` derivatives change, and `hub`. `radians` is the unit of
   the angle. */
PRIVATE void take_hub(const Hub *hub, const Estimate *moved, double radians, long long orders,
                      Estimate *estimate);

#endif
