/*
 * The arrays that the compiled part of the tracker works on: of History, of Bodies, and of new
 * frames.
 *
 * Names and shapes are those of history.py and bodies.py; all arrays are row-major.
 */

#ifndef KINPOLE_FRAMES_H
#define KINPOLE_FRAMES_H

#include "call.h"
#include "structs.h"

/* Length of the window and lag, ns; whether the input are poses; limits for poses off their paths
   and off their pins: see rejection.py. */
#define FRAME_LIMITS_FIELDS(VALUE, BLOCK, ARRAY) \
    VALUE(long long, window)                     \
    VALUE(long long, posed)                      \
    VALUE(double, lag)                           \
    VALUE(double, far)                           \
    VALUE(double, newest_factor)                 \
    VALUE(double, near)                          \
    VALUE(double, gap)                           \
    VALUE(double, n_sigma)

typedef STRUCT(FRAME_LIMITS_FIELDS) FrameLimits;

/* Columns of the history, of which rows `first` to `end` are in use. The next result is that of row
   `due`, counted from `first`. The window has `samples` frames, with a mean `interval`, ns. */
#define HISTORY_COLUMNS_FIELDS(VALUE, BLOCK, ARRAY) \
    VALUE(long long, first)                         \
    VALUE(long long, end)                           \
    VALUE(long long, due)                           \
    VALUE(long long, samples)                       \
    VALUE(double, interval)                         \
    ARRAY(long long, stamp)                         \
    ARRAY(long long, time)                          \
    ARRAY(long long, count)                         \
    ARRAY(unsigned char, goes_on)                   \
    ARRAY(unsigned char, used)                      \
    ARRAY(double, angle)                            \
    ARRAY(double, turns)                            \
    ARRAY(double, information)                      \
    ARRAY(double, height)                           \
    ARRAY(double, heights)                          \
    ARRAY(double, extra_turn)                       \
    ARRAY(Number, position)                         \
    ARRAY(Number, residual)                         \
    ARRAY(Number, markers)

typedef STRUCT(HISTORY_COLUMNS_FIELDS) HistoryColumns;

/* What is known of `count` bodies with up to `width` markers. */
#define BODY_ARRAYS_FIELDS(VALUE, BLOCK, ARRAY) \
    VALUE(long long, count)                     \
    VALUE(long long, width)                     \
    ARRAY(Number, shape)                        \
    ARRAY(Number, hub)                          \
    ARRAY(Number, middle)                       \
    ARRAY(Number, pin)                          \
    ARRAY(Number, pin_arm)                      \
    ARRAY(Number, known_shape)                  \
    ARRAY(double, weights)                      \
    ARRAY(double, largest)                      \
    ARRAY(double, doubtful)                     \
    ARRAY(double, spread)                       \
    ARRAY(double, loosest)                      \
    ARRAY(double, last_angle)                   \
    ARRAY(double, jump_scale)                   \
    ARRAY(double, size)                         \
    ARRAY(double, error)                        \
    ARRAY(double, scale)                        \
    ARRAY(double, noise)                        \
    ARRAY(double, freedom)                      \
    ARRAY(double, pin_variance)                 \
    ARRAY(double, tilt_turn)                    \
    ARRAY(long long, pin_since)                 \
    ARRAY(unsigned char, reason)                \
    ARRAY(unsigned char, never_repeats)

typedef STRUCT(BODY_ARRAYS_FIELDS) BodyArrays;

/* Whether measured markers of a body may repeat those of the frame before to the last bit: any may,
   not all do at once, or no marker does twice in a row. */
enum { MAY_REPEAT, NO_POSE_REPEATS, NO_MARKER_REPEATS };

/* Of each body, and last of the whole frame: number of gaps of a window or more; begin and length,
   ns, of the latest and of the longest. */
enum { OUTAGE_TIMES, OUTAGE_LATEST, OUTAGE_LONGEST = 3, OUTAGE_FIELDS = 5 };

/* What only C writes of the bodies: see step.py. */
#define BODY_TRACKS_FIELDS(VALUE, BLOCK, ARRAY) \
    ARRAY(unsigned char, unusual)               \
    ARRAY(long long, wrong)                     \
    ARRAY(long long, held)                      \
    ARRAY(long long, held_markers)              \
    ARRAY(long long, newest)                    \
    ARRAY(long long, seen_last)                 \
    ARRAY(long long, outages)                   \
    ARRAY(double, total_turn)                   \
    ARRAY(double, sure_angle)                   \
    ARRAY(Number, sure_tilt)

typedef STRUCT(BODY_TRACKS_FIELDS) BodyTracks;

/* New frames, of which `frame` to `frames` are still to be taken, at most `until_update` of them
   before the next update; `tilts` (T, B) of poses, see pose_points.py, else NULL. `corrected` are
   the markers (B, n) to fit to in the next frame, whatever is unusual; NULL for those that came. */
#define NEW_FRAMES_FIELDS(VALUE, BLOCK, ARRAY) \
    VALUE(long long, frame)                    \
    VALUE(long long, frames)                   \
    VALUE(long long, until_update)             \
    VALUE(long long, hidden_is_unusual)        \
    ARRAY(const long long, stamp)              \
    ARRAY(const long long, time)               \
    ARRAY(const long long, count)              \
    ARRAY(const Number, points)                \
    ARRAY(const double, heights)               \
    ARRAY(const Number, tilts)                 \
    ARRAY(const Number, corrected)

typedef STRUCT(NEW_FRAMES_FIELDS) NewFrames;

#define FRAMES_FIELDS(VALUE, BLOCK, ARRAY) \
    VALUE(FrameLimits, limits)             \
    VALUE(HistoryColumns, history)         \
    VALUE(BodyArrays, bodies)              \
    VALUE(BodyTracks, tracks)              \
    VALUE(NewFrames, incoming)

typedef STRUCT(FRAMES_FIELDS) Frames;

/* Results (T, ...) of at most `instants` instants, of which `count` are filled, and `deformed` are
   of bodies whose markers move against each other; none while a window has fewer than `fewest`
   frames. `rows` (T, 3) are those of the history, of the instant and of the oldest and newest of
   its window. `derivatives` are those of `Call`. See estimate.py. */
#define RESULTS_FIELDS(VALUE, BLOCK, ARRAY) \
    VALUE(long long, instants)              \
    VALUE(long long, count)                 \
    VALUE(long long, fewest)                \
    VALUE(long long, deformed)              \
    ARRAY(long long, stamp)                 \
    ARRAY(long long, due)                   \
    ARRAY(long long, rows)                  \
    ARRAY(double, derivatives)              \
    ARRAY(double, size)                     \
    ARRAY(double, height)                   \
    ARRAY(double, pin_variance)             \
    ARRAY(double, frame_angle)              \
    ARRAY(double, information)              \
    ARRAY(double, noise)                    \
    ARRAY(Number, pin)                      \
    ARRAY(Number, shape)                    \
    ARRAY(Number, reference)                \
    ARRAY(Number, frame_position)           \
    ARRAY(Number, middle)                   \
    ARRAY(unsigned char, reason)

typedef STRUCT(RESULTS_FIELDS) Results;

API int kinpole_try_frame(Frames *f, const Number *markers);
API int kinpole_follow(Frames *f, Call *call, Results *r);

#endif
