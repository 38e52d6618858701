/*
 * The arrays that the compiled part of the tracker works on.
 *
 * Shapes have B bodies with up to n markers, T instants, N new frames, and the rows of the history
 * that there is memory for. Arrays are row-major. Complex numbers are points or vectors of the
 * plane of the motion. The frame of a body is fixed to it. Information is an inverse variance,
 * times the variance of a coordinate of a marker. A tilt is the sine of half the angle between the
 * normals of the plane and of a body, in the direction in which the body sees the former lean.
 */

#ifndef KINPOLE_FRAMES_H
#define KINPOLE_FRAMES_H

#include "call.h"

/* What does not change while the parameters stay: see rejection.py for the limits. */
#define FRAME_LIMITS_FIELDS(VALUE, BLOCK, ARRAY)                                           \
    VALUE(long long, window_ns, "ns: length of the window")                                \
    VALUE(double, lag_ns, "ns: age of a frame when its result is due")                     \
    VALUE(long long, complete, "1 if each frame gets a result, also at the ends")          \
    VALUE(double, far, "a pose farther off its path, in standard deviations, is not used") \
    VALUE(double, newest_factor, "the same of the newest poses, over `far`")               \
    VALUE(double, near, "rad, or body sizes: a pose nearer to its path is always used")    \
    VALUE(double, gap, "intervals: frames farther apart do not follow each other")         \
    VALUE(double, n_sigma, "a pose farther off its pin, in standard deviations, is off")

typedef STRUCT(FRAME_LIMITS_FIELDS) FrameLimits;

/* The frames of late. */
#define HISTORY_COLUMNS_FIELDS(VALUE, BLOCK, ARRAY)                                                \
    VALUE(long long, first, "first row in use")                                                    \
    VALUE(long long, end, "row after the last one in use")                                         \
    VALUE(long long, next_result, "row of which the next result is, from `first` on")              \
    VALUE(long long, window_frames, "frames of the window")                                        \
    VALUE(double, interval, "ns: mean interval of these")                                          \
    ARRAY(long long, stamp, "(rows)", "ns: stamp as the message has it")                           \
    ARRAY(long long, time, "(rows)", "ns: when each frame was, by the clock")                      \
    ARRAY(long long, tick, "(rows)", "number of the tick of the clock, where frames are counted")  \
    ARRAY(Flag, goes_on, "(rows)", "whether there is no gap before the frame")                     \
    ARRAY(Flag, used, "(rows, B, n)", "whether the pose is fitted to the marker")                  \
    ARRAY(double, angle, "(rows, B)", "rad: angle of the body, in [-pi, pi]; NaN if unknown")      \
    ARRAY(double, turns, "(rows, B)", "whole turns to add to the angle")                           \
    ARRAY(double, information, "(rows, 2, B)", "m^2, 1: of angle and position; 0 if not used")     \
    ARRAY(double, height, "(rows, B)", "m: mean height of the markers seen")                       \
    ARRAY(double, heights, "(rows, B, n)", "m: heights of the markers over the plane")             \
    ARRAY(double, tilt_turn, "(rows, B)", "rad: turn about the normal beyond that of the heading") \
    ARRAY(Number, position, "(rows, B)", "m: origin of the frame of the body")                     \
    ARRAY(Number, residual, "(rows, B, n)", "m: marker minus fitted marker, in the body frame")    \
    ARRAY(Number, markers, "(rows, B, n)", "m: markers as they came; NaN for those not seen")

typedef STRUCT(HISTORY_COLUMNS_FIELDS) HistoryColumns;

/* What is known of the bodies: see bodies.py. */
#define BODY_ARRAYS_FIELDS(VALUE, BLOCK, ARRAY)                                                    \
    VALUE(long long, bodies, "B")                                                                  \
    VALUE(long long, width, "n: slots of markers of a body")                                       \
    ARRAY(Number, shape, "(B, n)", "m: markers in the body frame; 0 if not seen yet")              \
    ARRAY(Number, reference, "(B)", "m: point whose position is derived, in the body frame")       \
    ARRAY(Number, middle, "(B)", "m: point whose position and angle have independent errors")      \
    ARRAY(Number, pin, "(B)", "m: fixed point that the body turns about; NaN for none")            \
    ARRAY(Number, pin_arm, "(B)", "m: the pin, in the body frame")                                 \
    ARRAY(Number, places, "(B, n)", "m: `shape`, NaN for markers not seen yet")                    \
    ARRAY(double, weights, "(B, n)", "weights of the markers in a fit; 0 for those not seen yet")  \
    ARRAY(double, largest, "(B, n)", "m^2: a marker whose squared residual is larger is unusual")  \
    ARRAY(double, doubtful, "(B, n)", "m^2: the same of a marker whose name is doubtful")          \
    ARRAY(double, spread, "(B)", "m^2: sum of squared distances of the markers from their mean")   \
    ARRAY(double, loosest, "(B)", "m^2: least spread of markers that show an angle")               \
    ARRAY(double, jump_scale, "(2, B)", "rad, m: sigma of angle and position about their paths")   \
    ARRAY(double, size, "(B)", "m: diameter of the body")                                          \
    ARRAY(double, marker_variance, "(B)", "m^2: of a coordinate, no less than rounding")           \
    ARRAY(double, information_factor, "(2, B)", "factors of `information` of angle and position")  \
    ARRAY(double, fit_noise, "(B)", "m: sigma of a coordinate of a marker; 1 if unknown")          \
    ARRAY(double, angle_noise, "(B)", "rad: of measured poses; NaN for poses fitted to markers")   \
    ARRAY(double, freedom, "(B)", "degrees of freedom of a deformed body; 0 for a rigid one")      \
    ARRAY(double, pin_variance, "(B)", "m^2: variance of a coordinate of the pin")                 \
    ARRAY(double, learned_tilt_turn, "(B)", "rad: `tilt_turn` when the hub was learned")           \
    ARRAY(long long, pin_since, "(B)", "ns: time from which on the pin holds")                     \
    ARRAY(long long, spectrum, "(B)", "number of the spectrum of each body; 0 for none")           \
    ARRAY(unsigned char, reason, "(B)", "REASONS: why the body has no results, whatever its pose") \
    ARRAY(unsigned char, repetition, "(B)", "REPETITIONS: how measured markers may repeat")

typedef STRUCT(BODY_ARRAYS_FIELDS) BodyArrays;

/* Times without a body, or without any frame, of a window or more. */
#define GAPS_FIELDS(VALUE, BLOCK, ARRAY)                                \
    VALUE(long long, times, "number of gaps")                           \
    VALUE(long long, latest_begin, "ns: stamp before the latest gap")   \
    VALUE(long long, latest_length, "ns: length of the latest gap")     \
    VALUE(long long, longest_begin, "ns: stamp before the longest gap") \
    VALUE(long long, longest_length, "ns: length of the longest gap")

typedef STRUCT(GAPS_FIELDS) Gaps;

/* What only C writes of the bodies: see step.py. A pose is surely right once it is not left out. */
#define BODY_TRACKS_FIELDS(VALUE, BLOCK, ARRAY)                                                    \
    ARRAY(unsigned char, unusual, "(B)", "UNUSUAL_BITS of the last frame")                         \
    ARRAY(long long, wrong, "(B)", "number of poses that were off their paths")                    \
    ARRAY(long long, poses_held, "(B)", "poses that the driver repeated, not counted yet")         \
    ARRAY(long long, markers_held, "(B)", "markers that the driver repeated, not counted yet")     \
    ARRAY(long long, left_out, "(B)", "newest poses that may be wrong, and are not used yet")      \
    ARRAY(long long, seen_last, "(B)", "ns: stamp of the last pose; -1 for none")                  \
    ARRAY(Gaps, outages, "(B + 1)", "gaps of each body; Python writes the last, of all frames")    \
    ARRAY(double, sure_tilt_turn, "(B)", "rad: `tilt_turn` of the last pose that is surely right") \
    ARRAY(double, sure_angle, "(B)", "rad: angle of this pose")                                    \
    ARRAY(double, last_angle, "(B)", "rad: last angle that was known; NaN for none")               \
    ARRAY(Number, sure_tilt, "(B)", "tilt of this pose")

typedef STRUCT(BODY_TRACKS_FIELDS) BodyTracks;

/* Frames that are to be taken. */
#define NEW_FRAMES_FIELDS(VALUE, BLOCK, ARRAY)                                            \
    VALUE(long long, frame, "next frame to take")                                         \
    VALUE(long long, frames, "N")                                                         \
    VALUE(long long, until_update, "frames to take before the next update")               \
    VALUE(long long, hidden_is_unusual, "1 if a frame with a hidden marker is unusual")   \
    ARRAY(const long long, stamp, "(N)", "ns: stamp as the message has it")               \
    ARRAY(const long long, time, "(N)", "ns: when each frame was, by the clock")          \
    ARRAY(const long long, tick, "(N)", "number of the tick of the clock")                \
    ARRAY(const Number, points, "(N, B, n)", "m: markers; NaN for those not seen")        \
    ARRAY(const double, heights, "(N, B, n)", "m: heights of the markers over the plane") \
    ARRAY(const Number, tilts, "(N, B)", "tilts of poses; NULL for markers")              \
    ARRAY(const Number, corrected, "(B, n)", "m: markers to fit the next frame to, or NULL")

typedef STRUCT(NEW_FRAMES_FIELDS) NewFrames;

#define FRAMES_FIELDS(VALUE, BLOCK, ARRAY)                        \
    VALUE(FrameLimits, limits, "limits that do not change")       \
    VALUE(HistoryColumns, history, "the frames of late")          \
    VALUE(BodyArrays, known, "what is known of the bodies")       \
    VALUE(BodyTracks, tracks, "what only C writes of the bodies") \
    VALUE(NewFrames, incoming, "frames to take")

typedef STRUCT(FRAMES_FIELDS) Frames;

/* Results of instants: see estimate.py. */
#define RESULTS_FIELDS(VALUE, BLOCK, ARRAY)                                                      \
    VALUE(long long, instants, "T, the instants that there is memory for")                       \
    VALUE(long long, filled, "number of instants that have results")                             \
    VALUE(long long, fewest, "frames of the window that a result needs")                         \
    VALUE(long long, deformed, "number of instants with results of deformed bodies")             \
    VALUE(DerivativeArrays, derivatives, "derivatives; NaN where `reason` says so")              \
    ARRAY(long long, stamp, "(T)", "ns: the instant, a stamp")                                   \
    ARRAY(long long, due, "(T)", "the new frame with which the result fell due")                 \
    ARRAY(long long, rows, "(T, 3)", "rows from `first` on: the instant, oldest, newest")        \
    ARRAY(double, size, "(T, B)", "m: diameter of the body")                                     \
    ARRAY(double, height, "(T, B)", "m: mean height of the markers seen")                        \
    ARRAY(double, pin_variance, "(T, B)", "m^2: variance of a coordinate of the pin")            \
    ARRAY(double, frame_angle, "(T, B)", "rad: angle fitted to the frame alone, with its turns") \
    ARRAY(double, information, "(T, 2, B)", "m^2, 1: of angle and position, times its factors")  \
    ARRAY(double, noise, "(T, B)", "m: standard deviation of a coordinate of a marker")          \
    ARRAY(Number, pin, "(T, B)", "m: fixed point that the body turns about; NaN for none")       \
    ARRAY(Number, shape, "(T, B, n)", "m: `places` when the result was computed")                \
    ARRAY(Number, frame_position, "(T, B)", "m: position fitted to the frame alone")             \
    ARRAY(Number, middle, "(T, B)", "m: `middle` of this pose, in the body frame")               \
    ARRAY(unsigned char, reason, "(T, B)", "REASONS: why there is no result")

typedef STRUCT(RESULTS_FIELDS) Results;

/* Fits poses to `markers` (B, n), m, as if they were the next frame. Writes the row after the last
   one in use, for which there is memory, which stays out of use, and `unusual`. Returns the
   UNUSUAL_BITS of all bodies. */
API int kinpole_try_frame(Frames *f, const Number *markers);
/* Takes frames while they are usual, until the next update, and computes the results that are due.
   There is memory for the rows of all new frames. Changes the history, the tracks, `incoming`, `r`
   and what `kinpole_derive` changes of `call`. Returns DONE, UNUSUAL if Python has to take the
   next frame, or an error below 0. */
API int kinpole_follow(Frames *f, Call *call, Results *r);

#endif
