/*
 * The arrays that the compiled part of the tracker works on: of History, of Bodies, and of new frames.
 *
 * Names and shapes are those of history.py and bodies.py; all arrays are row-major.
 */

#include <complex.h>

typedef double complex Number;

/* Of bodies with up to `width` markers. Rows `first` to `end` of the history are in use. The next
   result is that of row `due`, counted from `first`. The new frames `frame` to `frames` are still to be
   taken, at most `until_update` of them before the next update. */
typedef struct {
    long long bodies, width, first, end, due;
    long long frame, frames, until_update, hidden_is_unusual;
    /* Length of the window and lag, ns; number of frames in the window, and their mean interval, ns;
       whether the input are poses. */
    long long window, samples, posed;
    double lag, interval;
    /* Limits for poses off their paths: see step.py. */
    double far, newest_factor, near, gap, n_sigma;
    /* Columns of the history. */
    long long *stamp, *time, *count;
    unsigned char *goes_on, *used;
    double *angle, *turns, *information, *height, *heights, *extra_turn;
    Number *position, *residual, *markers;
    /* What is known of the bodies. */
    Number *shape, *hub, *middle, *pin, *pin_arm, *known_shape;
    double *weights, *largest, *doubtful, *spread, *loosest, *last_angle, *jump_scale, *size;
    double *error, *scale, *noise, *freedom, *pin_variance, *tilt_turn;
    long long *pin_since;
    unsigned char *reason;
    /* The state of the bodies: see step.py. */
    unsigned char *unusual;
    long long *wrong, *newest, *seen_last;
    double *total_turn, *sure_angle;
    Number *sure_tilt;
    /* The new frames; `tilts` (T, B) of poses, see `MarkerAssignment.tilts`, else NULL. */
    const long long *new_stamp, *new_time, *new_count;
    const Number *points;
    const double *point_heights;
    const Number *tilts;
    /* The markers (B, n) to fit to in the next frame, whatever is unusual; NULL for those that came. */
    const Number *corrected;
} Frames;

/* What is unusual of a body in a frame. */
enum { ODD = 1, NAME_DOUBTFUL = 2, NEW_MARKER = 4 };

static inline double
square_of(Number z)
{
    return creal(z) * creal(z) + cimag(z) * cimag(z);
}

int kinpole_fit_frame(const Frames *f, const Number *markers, int goes_on);
void kinpole_follow_paths(const Frames *f);
