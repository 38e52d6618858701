/*
 * Poses fitted to the markers of a frame.
 *
 * Arrays are those of frames.h.
 */

#include <math.h>

#include "fit.h"
#include "numbers.h"
#include "rejection.h"

/* Markers nearer together than this part of their distance from the origin are at one place: four
   units of rounding. No length below the least normal double is a direction. */
static const double SAME_PLACE = 4 * 2.220446049250313e-16, LEAST_LENGTH = 2.2250738585072014e-308;

/* Fits the pose of body `b` to its markers `points` (n), m, by weighted least squares: turn and
   position that bring its shape nearest to them (Procrustes). A marker is used if it has a weight,
   is seen, and does not repeat while measured ones never do. There is no pose, NaN with an
   information of 0, without two markers at different places, or where all repeat: then no marker is
   used. Nor is there one if markers are too close together for their noise: then they stay used, as
   the frame shows them. Writes the newest row, and returns its UNUSUAL_BITS; a turn since the row
   before is one of them only if the row `goes_on`. */
static int
fit(const Frames *f, long long b, const Number *points, int goes_on)
{
    const HistoryColumns *history = &f->history;
    const BodyArrays *known = &f->known;
    long long n = known->width, newest = history->end - 1, at = newest * known->bodies + b;
    const Number *shape = known->shape + b * n;
    const double *weights = known->weights + b * n;
    Number *residual = history->residual + at * n, middle = 0.0, mean = 0.0, cross = 0.0;
    double total = 0.0, spread = 0.0, reach = 0.0, shape_reach = 0.0;
    int found = 0;
    for (long long k = 0; k < n; k++) {
        int is_seen = !isnan(creal(points[k])) && !kinpole_is_marker_held(f, b, points, k);
        if (weights[k] > 0.0 && is_seen && !isnan(cimag(points[k]))) {
            total += weights[k];
            middle += weights[k] * points[k];
            mean += weights[k] * shape[k];
            history->used[at * n + k] = 1;
        } else {
            history->used[at * n + k] = 0;
            found |= weights[k] > 0.0 || !is_seen ? 0 : NEW_MARKER;
        }
    }
    middle /= total;
    mean /= total;
    for (long long k = 0; k < n; k++)
        if (history->used[at * n + k]) {
            Number arm = points[k] - middle, shape_arm = shape[k] - mean;
            double square = square_of(shape_arm);
            cross += weights[k] * conj(shape_arm) * arm;
            spread += weights[k] * square;
            reach = larger(reach, square_of(arm));
            shape_reach = larger(shape_reach, square);
        }
    double length = cabs(cross);
    int fits = !kinpole_is_held(f, b, points) && length > LEAST_LENGTH &&
        sqrt(reach) > SAME_PLACE * cabs(middle) && sqrt(shape_reach) > SAME_PLACE * cabs(mean);
    Number turn = fits ? cross / length : NAN;
    double angle = fits ? atan2(cimag(turn), creal(turn)) : NAN;
    for (long long k = 0; k < n; k++) {
        if (!history->used[at * n + k] || !fits) {
            history->used[at * n + k] = 0;
            residual[k] = NAN + NAN * I;
            continue;
        }
        residual[k] = (points[k] - middle) * conj(turn) - (shape[k] - mean);
        found |= verdict_on_marker(f, b, k, square_of(residual[k]));
    }
    if (goes_on && cos(angle - f->tracks.last_angle[b]) < 0.0)
        found |= ODD;
    int is_known = fits && !is_unsteady(f, b, spread);
    history->angle[at] = is_known ? angle : NAN;
    history->position[at] = is_known ? middle - turn * mean : NAN;
    double *information = history->information + 2 * newest * known->bodies + b;
    int is_measured = !isnan(known->angle_noise[b]);
    information[0] = !is_known ? 0.0 : is_measured ? 1.0 : spread;
    information[known->bodies] = !is_known ? 0.0 : is_measured ? 1.0 :
        1.0 / (1.0 / total + square_of(mean) / spread);
    return found;
}

void
kinpole_unwrap(const Frames *f)
{
    const HistoryColumns *history = &f->history;
    const BodyArrays *known = &f->known;
    double *last_angle = f->tracks.last_angle;
    for (long long b = 0; b < known->bodies; b++) {
        long long at = (history->end - 1) * known->bodies + b;
        double turns = history->end - 1 > history->first ? history->turns[at - known->bodies] : 0.0;
        double angle = history->angle[at], last = last_angle[b];
        if (!isnan(angle)) {
            turns -= isnan(last) ? 0.0 : rint((angle - last) / TURN);
            last_angle[b] = angle;
        }
        history->turns[at] = turns;
    }
}

int
kinpole_fit_frame(const Frames *f, const Number *markers, int goes_on)
{
    int found = 0;
    for (long long b = 0; b < f->known.bodies; b++)
        found |= f->tracks.unusual[b] = fit(f, b, markers + b * f->known.width, goes_on);
    return found;
}
