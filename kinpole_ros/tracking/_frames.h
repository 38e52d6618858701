/*
 * The arrays that the compiled part of the tracker works on: of History, of Bodies, and of new frames.
 *
 * Names and shapes are those of history.py and bodies.py; all arrays are row-major. Each list here is
 * the only one: Python reads it as text, see `structure_of` and `codes_of` in compiled.py.
 */

#ifndef KINPOLE_FRAMES_H
#define KINPOLE_FRAMES_H

#include <complex.h>

typedef double complex Number;

#define AS_FIELD(type, name) type name;
#define AS_FIELD_TEXT(type, name) #name "=" #type ";"
#define AS_CODE(name, value) name = value,
#define AS_CODE_TEXT(name, value) #name "=" #value ";"

/* Bodies with up to `width` markers. Rows `first` to `end` of the history are in use. The next result is
   that of row `due`, counted from `first`. The new frames `frame` to `frames` are still to be taken, at
   most `until_update` of them before the next update. */
#define FRAMES_COUNTS(FIELD)                                                                             \
    FIELD(long long, bodies)                                                                             \
    FIELD(long long, width)                                                                              \
    FIELD(long long, first)                                                                              \
    FIELD(long long, end)                                                                                \
    FIELD(long long, due)                                                                                \
    FIELD(long long, frame)                                                                              \
    FIELD(long long, frames)                                                                             \
    FIELD(long long, until_update)                                                                       \
    FIELD(long long, hidden_is_unusual)

/* Length of the window and lag, ns; number of frames in the window, and their mean interval, ns; whether
   the input are poses. */
#define FRAMES_WINDOW(FIELD)                                                                             \
    FIELD(long long, window)                                                                             \
    FIELD(long long, samples)                                                                            \
    FIELD(long long, posed)                                                                              \
    FIELD(double, lag)                                                                                   \
    FIELD(double, interval)

/* Limits for poses off their paths and off their pins: see rejection.py. */
#define FRAMES_LIMITS(FIELD)                                                                             \
    FIELD(double, far)                                                                                   \
    FIELD(double, newest_factor)                                                                         \
    FIELD(double, near)                                                                                  \
    FIELD(double, gap)                                                                                   \
    FIELD(double, n_sigma)

/* Columns of the history. */
#define FRAMES_HISTORY(FIELD)                                                                            \
    FIELD(long long *, stamp)                                                                            \
    FIELD(long long *, time)                                                                             \
    FIELD(long long *, count)                                                                            \
    FIELD(unsigned char *, goes_on)                                                                      \
    FIELD(unsigned char *, used)                                                                         \
    FIELD(double *, angle)                                                                               \
    FIELD(double *, turns)                                                                               \
    FIELD(double *, information)                                                                         \
    FIELD(double *, height)                                                                              \
    FIELD(double *, heights)                                                                             \
    FIELD(double *, extra_turn)                                                                          \
    FIELD(Number *, position)                                                                            \
    FIELD(Number *, residual)                                                                            \
    FIELD(Number *, markers)

/* What is known of the bodies. */
#define FRAMES_LEARNED(FIELD)                                                                            \
    FIELD(Number *, shape)                                                                               \
    FIELD(Number *, hub)                                                                                 \
    FIELD(Number *, middle)                                                                              \
    FIELD(Number *, pin)                                                                                 \
    FIELD(Number *, pin_arm)                                                                             \
    FIELD(Number *, known_shape)                                                                         \
    FIELD(double *, weights)                                                                             \
    FIELD(double *, largest)                                                                             \
    FIELD(double *, doubtful)                                                                            \
    FIELD(double *, spread)                                                                              \
    FIELD(double *, loosest)                                                                             \
    FIELD(double *, last_angle)                                                                          \
    FIELD(double *, jump_scale)                                                                          \
    FIELD(double *, size)                                                                                \
    FIELD(double *, error)                                                                               \
    FIELD(double *, scale)                                                                               \
    FIELD(double *, noise)                                                                               \
    FIELD(double *, freedom)                                                                             \
    FIELD(double *, pin_variance)                                                                        \
    FIELD(double *, tilt_turn)                                                                           \
    FIELD(long long *, pin_since)                                                                        \
    FIELD(unsigned char *, reason)

/* Of each body, and last of the whole frame: number of gaps of a window or more; begin and length, ns, of
   the latest and of the longest. */
enum { OUTAGE_TIMES, OUTAGE_LATEST, OUTAGE_LONGEST = 3, OUTAGE_FIELDS = 5 };

/* The state of the bodies that only C writes: see step.py. */
#define FRAMES_STATE(FIELD)                                                                              \
    FIELD(unsigned char *, unusual)                                                                      \
    FIELD(long long *, wrong)                                                                            \
    FIELD(long long *, newest)                                                                           \
    FIELD(long long *, seen_last)                                                                        \
    FIELD(long long *, outages)                                                                          \
    FIELD(double *, total_turn)                                                                          \
    FIELD(double *, sure_angle)                                                                          \
    FIELD(Number *, sure_tilt)

/* The new frames; `tilts` (T, B) of poses, see `MarkerAssignment.tilts`, else NULL. */
#define FRAMES_NEW(FIELD)                                                                                \
    FIELD(const long long *, new_stamp)                                                                  \
    FIELD(const long long *, new_time)                                                                   \
    FIELD(const long long *, new_count)                                                                  \
    FIELD(const Number *, points)                                                                        \
    FIELD(const double *, point_heights)                                                                 \
    FIELD(const Number *, tilts)

/* The markers (B, n) to fit to in the next frame, whatever is unusual; NULL for those that came. */
#define FRAMES_CORRECTED(FIELD) FIELD(const Number *, corrected)

typedef struct {
    FRAMES_COUNTS(AS_FIELD)
    FRAMES_WINDOW(AS_FIELD)
    FRAMES_LIMITS(AS_FIELD)
    FRAMES_HISTORY(AS_FIELD)
    FRAMES_LEARNED(AS_FIELD)
    FRAMES_STATE(AS_FIELD)
    FRAMES_NEW(AS_FIELD)
    FRAMES_CORRECTED(AS_FIELD)
} Frames;

static inline double
square_of(Number z)
{
    return creal(z) * creal(z) + cimag(z) * cimag(z);
}

int kinpole_fit_frame(const Frames *f, const Number *markers, int goes_on);
void kinpole_unwrap(const Frames *f);

#endif
