/*
 * What the compiled part of the tracker works on: arrays of History and Bodies, and frames that come.
 *
 * Names and shapes are those of history.py and bodies.py; all arrays are row-major.
 */

#include <complex.h>

typedef double complex Number;

/* Rows from `first` to `end` of the history are in use; results are known up to row `due`, counted
   from `first`. Frames from `frame` to `frames` of those that came are still to be taken, at most
   `until_update` of them before the next update. */
typedef struct {
    long long bodies, markers, first, end, due;
    long long frame, frames, until_update, hidden_is_unusual;
    /* The length of the window and the lag, ns; the number of frames in the window and the mean
       interval between them, ns. */
    long long window, samples, posed;
    double lag, interval;
    /* How far poses may be off their paths: see step.py. */
    double far, newest_far, near, gap, sure;
    /* Columns of the history. */
    long long *stamp, *time, *count;
    unsigned char *goes_on, *used;
    double *angle, *turns, *information, *height, *heights, *extra_turn;
    Number *position, *residual, *marker;
    /* Of the bodies, as they were learned. */
    Number *shape, *hub, *middle, *pin, *pin_arm, *known_shape;
    double *weights, *largest, *doubtful, *spread, *loosest, *last_angle, *jump_scale, *size;
    double *error, *scale, *noise, *freedom, *pin_variance, *turned;
    long long *pin_since;
    unsigned char *unusable;
    /* What is counted of the bodies: see step.py. */
    unsigned char *unusual;
    long long *wrong, *newest, *seen_last;
    /* The frames that came. */
    const long long *new_stamp, *new_time, *new_count;
    const Number *points;
    const double *point_heights;
} Frames;

/* What is unusual of a body in a frame. */
enum { ODD = 1, NAME_DOUBTFUL = 2, NEW_MARKER = 4 };

static inline double
square_of(Number z)
{
    return creal(z) * creal(z) + cimag(z) * cimag(z);
}

int kinpole_fit_frame(const Frames *f, const Number *markers, int goes_on, unsigned char *unusual);
void kinpole_follow_paths(const Frames *f, long long *wrong, long long *newest);
