/*
 * The fields of the structs that Python fills and reads, and the codes of enums, for bindings.py.
 */

#include <stddef.h>

#include "../include/change_points.h"
#include "../include/frames.h"
#include "../include/messages.h"

/* The `count` of a field that is no block; the structs or enums at most, with the end of the
   list. */
enum { OF_VALUE = 0, OF_ARRAY = -1, LONGEST_LIST = 32 };

/* `Owner` is the struct whose fields are described. */
#define DESCRIBE_VALUE(type, name, meaning) \
    {#name, #type, "", meaning, OF_VALUE, offsetof(Owner, name)},
#define DESCRIBE_BLOCK(type, name, count, meaning) \
    {#name, #type, "", meaning, count, offsetof(Owner, name)},
#define DESCRIBE_ARRAY(type, name, shape, meaning) \
    {#name, #type, shape, meaning, OF_ARRAY, offsetof(Owner, name)},
#define DESCRIBE_CODE(name, value) {#name, value},

#define ADD_STRUCT(name, FIELDS)                                                                \
    {                                                                                           \
        typedef name Owner;                                                                     \
        static const Field fields[] = {FIELDS(DESCRIBE_VALUE, DESCRIBE_BLOCK, DESCRIBE_ARRAY)}; \
        *next++ = (Description){#name, sizeof(name), sizeof fields / sizeof *fields, fields};   \
    }
#define ADD_CODES(LIST)                                                      \
    {                                                                        \
        static const Code codes[] = {LIST(DESCRIBE_CODE)};                   \
        *next++ = (Codes){#LIST, sizeof codes / sizeof *codes, codes};       \
    }

const Description *
kinpole_structs(void)
{
    static Description all[LONGEST_LIST];
    Description *next = all;
    ADD_STRUCT(Table, TABLE_FIELDS)
    ADD_STRUCT(DerivativeArrays, DERIVATIVE_ARRAYS_FIELDS)
    ADD_STRUCT(Call, CALL_FIELDS)
    ADD_STRUCT(FrameLimits, FRAME_LIMITS_FIELDS)
    ADD_STRUCT(HistoryColumns, HISTORY_COLUMNS_FIELDS)
    ADD_STRUCT(BodyArrays, BODY_ARRAYS_FIELDS)
    ADD_STRUCT(Gaps, GAPS_FIELDS)
    ADD_STRUCT(BodyTracks, BODY_TRACKS_FIELDS)
    ADD_STRUCT(NewFrames, NEW_FRAMES_FIELDS)
    ADD_STRUCT(Frames, FRAMES_FIELDS)
    ADD_STRUCT(Results, RESULTS_FIELDS)
    ADD_STRUCT(Motion, MOTION_FIELDS)
    ADD_STRUCT(Slots, SLOTS_FIELDS)
    ADD_STRUCT(MessageLayout, MESSAGE_LAYOUT_FIELDS)
    ADD_STRUCT(Row, ROW_FIELDS)
    ADD_STRUCT(Plane, PLANE_FIELDS)
    ADD_STRUCT(Joints, JOINTS_FIELDS)
    ADD_STRUCT(ChangePoint, CHANGE_POINT_FIELDS)
    return all;
}

const Codes *
kinpole_codes(void)
{
    static Codes all[LONGEST_LIST];
    Codes *next = all;
    ADD_CODES(SIZES)
    ADD_CODES(POLE_LIMITS)
    ADD_CODES(MESSAGE_DOUBLES)
    ADD_CODES(CALL_ENDS)
    ADD_CODES(TABLE_ORDERS)
    ADD_CODES(UNUSUAL_BITS)
    ADD_CODES(REASONS)
    ADD_CODES(REPETITIONS)
    ADD_CODES(QUANTITIES)
    ADD_CODES(QUANTITY_FLAGS)
    ADD_CODES(MESSAGE_KINDS)
    return all;
}
