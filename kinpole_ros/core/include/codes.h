/*
 * Numbers that C gives to verdicts, reasons, and ends of its functions, and that Python reads.
 */

#ifndef KINPOLE_CODES_H
#define KINPOLE_CODES_H

#include "structs.h"

/* The highest order of a derivative; models side by side in vectors; derivatives that may step,
   from the position on; derivatives by which uneven samples move, from the first on; samples of the
   shortest window, which still has every order; how many times as long a search for events looks
   before the middle of its windows as after it. */
#define SIZES(CODE)         \
    CODE(HIGHEST, 4)        \
    CODE(LANES, 8)          \
    CODE(STEP_ORDERS, 3)    \
    CODE(SLOPE_ORDERS, 4)   \
    CODE(FEWEST_SAMPLES, 7) \
    CODE(TIMES_BEFORE, 2)

enum { SIZES(DECLARE_CODE) };

/* What `kinpole_derive` and `kinpole_follow` return, errors below 0: no memory for another result;
   no table made; no memory; windows beyond the frames; all is done; the next frame is unusual. */
#define CALL_ENDS(CODE) \
    CODE(NO_ROOM, -4)   \
    CODE(NO_TABLE, -3)  \
    CODE(NO_MEMORY, -2) \
    CODE(NO_FRAMES, -1) \
    CODE(DONE, 0)       \
    CODE(UNUSUAL, 1)

enum { CALL_ENDS(DECLARE_CODE) };

/* Tables that are made for a kind of window, besides stencils, which have a number of orders. */
#define TABLE_ORDERS(CODE) \
    CODE(SLOPES, -1)       \
    CODE(MODELS, 0)

enum { TABLE_ORDERS(DECLARE_CODE) };

/* What is unusual of a body in a frame, as bits: a marker does not fit its place, or the body
   turned by more than a quarter; a marker is so far off that its name is doubtful; a marker has no
   place yet. */
#define UNUSUAL_BITS(CODE) \
    CODE(ODD, 1)           \
    CODE(NAME_DOUBTFUL, 2) \
    CODE(NEW_MARKER, 4)

enum { UNUSUAL_BITS(DECLARE_CODE) };

/* Why a body has no result, up to PLANE_UNKNOWN: of several up to OFF_PATH it is the largest; and
   why a quantity of a body with a pose is undetermined. The texts are in reasons.py, and programs
   read these numbers in the topic `state`: a number is never used again for something else. */
#define REASONS(CODE)      \
    CODE(KNOWN, 0)         \
    CODE(NOT_FULL, 1)      \
    CODE(TOO_NOISY, 2)     \
    CODE(NOISE_UNKNOWN, 3) \
    CODE(NOT_SEEN, 4)      \
    CODE(OFF_PATH, 5)      \
    CODE(ANGLE_NOISY, 6)   \
    CODE(NO_POSE, 7)       \
    CODE(PLANE_UNKNOWN, 8) \
    CODE(IN_NOISE, 9)      \
    CODE(NO_ROTATION, 10)  \
    CODE(AT_INFINITY, 11)  \
    CODE(ON_PIN, 12)       \
    CODE(ICR_IN_NOISE, 13) \
    CODE(STRAIGHT, 14)

enum { REASONS(DECLARE_CODE) };

/* How measured markers of a body may repeat those of the frame before to the last bit: any may, not
   all do at once, or no marker does twice in a row. */
#define REPETITIONS(CODE)     \
    CODE(MAY_REPEAT, 0)       \
    CODE(NO_POSE_REPEATS, 1)  \
    CODE(NO_MARKER_REPEATS, 2)

enum { REPETITIONS(DECLARE_CODE) };

/* What a quantity is. A pole has its order, and FREE plus that order is the pole by the motion
   alone; RATE plus its order is a derivative of the angle. VELOCITY is that of the ICR, CURVATURE
   that of the centrode, CIRCLE_CENTER and CIRCLE_DIAMETER are of the inflection circle,
   RELATIVE_RATE and RELATIVE_CENTER are of two bodies, and GIVEN is a quantity that a row of
   messages has with it. */
#define QUANTITIES(CODE)      \
    CODE(POLE_1, 1)           \
    CODE(POLE_2, 2)           \
    CODE(POLE_3, 3)           \
    CODE(POLE_4, 4)           \
    CODE(VELOCITY, 5)         \
    CODE(CURVATURE, 6)        \
    CODE(CIRCLE_CENTER, 7)    \
    CODE(CIRCLE_DIAMETER, 8)  \
    CODE(FREE, 10)            \
    CODE(FREE_POLE_1, 11)     \
    CODE(FREE_POLE_2, 12)     \
    CODE(FREE_POLE_3, 13)     \
    CODE(FREE_POLE_4, 14)     \
    CODE(RATE, 20)            \
    CODE(RATE_1, 21)          \
    CODE(RATE_2, 22)          \
    CODE(RATE_3, 23)          \
    CODE(RATE_4, 24)          \
    CODE(RELATIVE_RATE, 30)   \
    CODE(RELATIVE_CENTER, 31) \
    CODE(GIVEN, 32)

enum { QUANTITIES(DECLARE_CODE) };

/* A pole is determined if the turn of its order exceeds its standard deviation this many times, and
   if it is no farther than so many body sizes. */
#define POLE_LIMITS(CODE) \
    CODE(SIGNIFICANT, 4)  \
    CODE(FARTHEST, 1000)

enum { POLE_LIMITS(DECLARE_CODE) };

/* Bits of the flags of a quantity: it stands out of its noise; the ICR is seen to move. */
#define QUANTITY_FLAGS(CODE) \
    CODE(DETERMINED, 1)      \
    CODE(MOVES, 2)

enum { QUANTITY_FLAGS(DECLARE_CODE) };

/* What a message is: a vector along the normal, in the plane, a point at the height of a body, a
   pose with covariance, odometry, a frame of /tf, or the topic `state`. */
#define MESSAGE_KINDS(CODE) \
    CODE(NORMAL, 0)         \
    CODE(VECTOR, 1)         \
    CODE(POINT, 2)          \
    CODE(POSE, 3)           \
    CODE(ODOMETRY, 4)       \
    CODE(FRAME, 5)          \
    CODE(STATE, 6)

enum { MESSAGE_KINDS(DECLARE_CODE) };

#endif
