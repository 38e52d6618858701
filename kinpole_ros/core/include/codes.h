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

#endif
