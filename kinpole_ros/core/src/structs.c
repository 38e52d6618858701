/*
 * The fields of the structs that Python fills and reads, and the codes of enums, for bindings.py.
 */

#include <stddef.h>

#include "../include/call.h"
#include "../include/codes.h"
#include "../include/frames.h"
#include "../include/messages.h"
#include "../include/motion.h"
#include "../include/structs.h"

enum { OF_VALUE = 0, OF_ARRAY = -1 };

/* OWNER is the struct whose fields are described. */
#define DESCRIBE_VALUE(type, name) {#name, #type, OF_VALUE, offsetof(OWNER, name)},
#define DESCRIBE_BLOCK(type, name, count) {#name, #type, count, offsetof(OWNER, name)},
#define DESCRIBE_ARRAY(type, name) {#name, #type, OF_ARRAY, offsetof(OWNER, name)},
#define DESCRIBE(FIELDS) {FIELDS(DESCRIBE_VALUE, DESCRIBE_BLOCK, DESCRIBE_ARRAY)}

#define OWNER Table
static const Field table_fields[] = DESCRIBE(TABLE_FIELDS);
#undef OWNER
#define OWNER Call
static const Field call_fields[] = DESCRIBE(CALL_FIELDS);
#undef OWNER
#define OWNER FrameLimits
static const Field frame_limits_fields[] = DESCRIBE(FRAME_LIMITS_FIELDS);
#undef OWNER
#define OWNER HistoryColumns
static const Field history_columns_fields[] = DESCRIBE(HISTORY_COLUMNS_FIELDS);
#undef OWNER
#define OWNER BodyArrays
static const Field body_arrays_fields[] = DESCRIBE(BODY_ARRAYS_FIELDS);
#undef OWNER
#define OWNER BodyTracks
static const Field body_tracks_fields[] = DESCRIBE(BODY_TRACKS_FIELDS);
#undef OWNER
#define OWNER NewFrames
static const Field new_frames_fields[] = DESCRIBE(NEW_FRAMES_FIELDS);
#undef OWNER
#define OWNER Frames
static const Field frames_fields[] = DESCRIBE(FRAMES_FIELDS);
#undef OWNER
#define OWNER Results
static const Field results_fields[] = DESCRIBE(RESULTS_FIELDS);
#undef OWNER
#define OWNER Motion
static const Field motion_fields[] = DESCRIBE(MOTION_FIELDS);
#undef OWNER
#define OWNER Slots
static const Field slots_fields[] = DESCRIBE(SLOTS_FIELDS);
#undef OWNER
#define OWNER MessageLayout
static const Field message_layout_fields[] = DESCRIBE(MESSAGE_LAYOUT_FIELDS);
#undef OWNER
#define OWNER Row
static const Field row_fields[] = DESCRIBE(ROW_FIELDS);
#undef OWNER
#define OWNER Plane
static const Field plane_fields[] = DESCRIBE(PLANE_FIELDS);
#undef OWNER
#define OWNER Joints
static const Field joints_fields[] = DESCRIBE(JOINTS_FIELDS);
#undef OWNER

#define DESCRIPTION(name, fields) {#name, sizeof(name), sizeof fields / sizeof *fields, fields}

#define DESCRIBE_CODE(name, value) {#name, value},
static const Code sizes[] = {SIZES(DESCRIBE_CODE)};
static const Code pole_limits[] = {POLE_LIMITS(DESCRIBE_CODE)};
static const Code message_doubles[] = {MESSAGE_DOUBLES(DESCRIBE_CODE)};
static const Code call_ends[] = {CALL_ENDS(DESCRIBE_CODE)};
static const Code loop_ends[] = {LOOP_ENDS(DESCRIBE_CODE)};
static const Code unusual_bits[] = {UNUSUAL_BITS(DESCRIBE_CODE)};
static const Code reasons[] = {REASONS(DESCRIBE_CODE)};
static const Code quantities[] = {QUANTITIES(DESCRIBE_CODE)};
static const Code quantity_flags[] = {QUANTITY_FLAGS(DESCRIBE_CODE)};
static const Code message_kinds[] = {MESSAGE_KINDS(DESCRIBE_CODE)};

#define CODES(list, codes) {#list, sizeof codes / sizeof *codes, codes}

/* Return the descriptions of all structs; one of another that has it as a field comes before. */
const Description *
kinpole_structs(void)
{
    static const Description all[] = {
        DESCRIPTION(Table, table_fields),
        DESCRIPTION(Call, call_fields),
        DESCRIPTION(FrameLimits, frame_limits_fields),
        DESCRIPTION(HistoryColumns, history_columns_fields),
        DESCRIPTION(BodyArrays, body_arrays_fields),
        DESCRIPTION(BodyTracks, body_tracks_fields),
        DESCRIPTION(NewFrames, new_frames_fields),
        DESCRIPTION(Frames, frames_fields),
        DESCRIPTION(Results, results_fields),
        DESCRIPTION(Motion, motion_fields),
        DESCRIPTION(Slots, slots_fields),
        DESCRIPTION(MessageLayout, message_layout_fields),
        DESCRIPTION(Row, row_fields),
        DESCRIPTION(Plane, plane_fields),
        DESCRIPTION(Joints, joints_fields),
        {NULL, 0, 0, NULL},
    };
    return all;
}

/* Return the codes of all enums that Python reads. */
const Codes *
kinpole_codes(void)
{
    static const Codes all[] = {
        CODES(SIZES, sizes),
        CODES(POLE_LIMITS, pole_limits),
        CODES(MESSAGE_DOUBLES, message_doubles),
        CODES(CALL_ENDS, call_ends),
        CODES(LOOP_ENDS, loop_ends),
        CODES(UNUSUAL_BITS, unusual_bits),
        CODES(REASONS, reasons),
        CODES(QUANTITIES, quantities),
        CODES(QUANTITY_FLAGS, quantity_flags),
        CODES(MESSAGE_KINDS, message_kinds),
        {NULL, 0, NULL},
    };
    return all;
}
