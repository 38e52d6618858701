/*
 * Numbers that C gives to verdicts, reasons, and ends of its functions, and that Python reads.
 */

#ifndef KINPOLE_CODES_H
#define KINPOLE_CODES_H

#include "structs.h"

/* What `kinpole_derive` returns. */
#define CALL_ENDS(CODE) \
    CODE(NO_MEMORY, -2) \
    CODE(NO_FRAMES, -1) \
    CODE(DONE, 0)       \
    CODE(LACKING, 1)

enum { CALL_ENDS(DECLARE_CODE) };

/* Why the loop ends, besides the return values of `kinpole_derive`. */
#define LOOP_ENDS(CODE) \
    CODE(UNUSUAL, 2)    \
    CODE(FULL, 3)

enum { LOOP_ENDS(DECLARE_CODE) };

/* What is unusual of a body in a frame, as bits: a marker does not fit its place, or the body turned by
   more than a quarter; a marker is so far off that its name is doubtful; a marker has no place yet. */
#define UNUSUAL_BITS(CODE) \
    CODE(ODD, 1)           \
    CODE(NAME_DOUBTFUL, 2) \
    CODE(NEW_MARKER, 4)

enum { UNUSUAL_BITS(DECLARE_CODE) };

/* Why a body has no result; larger numbers go first. The texts are in rejection.py. */
#define REASONS(CODE)      \
    CODE(KNOWN, 0)         \
    CODE(NOT_FULL, 1)      \
    CODE(TOO_NOISY, 2)     \
    CODE(NOISE_UNKNOWN, 3) \
    CODE(NOT_SEEN, 4)      \
    CODE(OFF_PATH, 5)

enum { REASONS(DECLARE_CODE) };

/* What a quantity is. A pole of order 1 to 4 has its order, and FREE plus that order is the pole by the
   motion alone; RATE plus its order is a derivative of the angle. VELOCITY is that of the ICR, CURVATURE
   that of the centrode, and GIVEN a quantity that a row of messages has with it. */
#define QUANTITIES(CODE)      \
    CODE(VELOCITY, 5)         \
    CODE(CURVATURE, 6)        \
    CODE(FREE, 10)            \
    CODE(RATE, 20)            \
    CODE(RELATIVE_RATE, 30)   \
    CODE(RELATIVE_CENTER, 31) \
    CODE(GIVEN, 32)

enum { QUANTITIES(DECLARE_CODE) };

/* Bits of the flags of a quantity: it stands out of its noise; the ICR is seen to move. */
#define QUANTITY_FLAGS(CODE) \
    CODE(DETERMINED, 1)      \
    CODE(MOVES, 2)

enum { QUANTITY_FLAGS(DECLARE_CODE) };

/* What a message is: a vector along the normal, in the plane, a point at the height of a body, a pose
   with covariance, odometry, a frame of /tf, or the topic `state`. */
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
