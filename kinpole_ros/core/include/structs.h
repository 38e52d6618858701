/*
 * Structs whose fields Python fills and reads.
 *
 * The fields of such a struct are a list, which is a macro of three others:
 *
 *   #define SLOTS_FIELDS(VALUE, BLOCK, ARRAY) \
 *       VALUE(long long, count)               \
 *       BLOCK(double, basis, 9)               \
 *       ARRAY(const long long, rows)
 *   typedef STRUCT(SLOTS_FIELDS) Slots;
 *
 * A VALUE is in the struct, a BLOCK is so many of them, and an ARRAY points to the elements of an
 * array of numpy. The codes of an enum are such a list too:
 *
 *   #define LOOP_ENDS(CODE) \
 *       CODE(UNUSUAL, 2)    \
 *       CODE(FULL, 3)
 *   enum { LOOP_ENDS(DECLARE_CODE) };
 *
 * structs.c describes all lists, and bindings.py makes its classes of these descriptions, so no
 * field and no code is typed twice.
 */

#ifndef KINPOLE_STRUCTS_H
#define KINPOLE_STRUCTS_H

#include <complex.h>

typedef double complex Number;

#define DECLARE_VALUE(type, name) type name;
#define DECLARE_BLOCK(type, name, count) type name[count];
#define DECLARE_ARRAY(type, name) type *name;
#define STRUCT(FIELDS)                                       \
    struct {                                                 \
        FIELDS(DECLARE_VALUE, DECLARE_BLOCK, DECLARE_ARRAY) \
    }
#define DECLARE_CODE(name, value) name = value,

/* A function that Python calls: the library exports no others. */
#ifdef _WIN32
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

/* A field: its type as it is written, the number of a BLOCK, 0 for a VALUE, -1 for an ARRAY. */
typedef struct {
    const char *name, *type;
    long long count, offset;
} Field;

/* A struct of so many fields. */
typedef struct {
    const char *name;
    long long size, count;
    const Field *fields;
} Description;

typedef struct {
    const char *name;
    long long value;
} Code;

/* An enum of so many codes. */
typedef struct {
    const char *name;
    long long count;
    const Code *codes;
} Codes;

/* The last one of a list has no name. */
API const Description *kinpole_structs(void);
API const Codes *kinpole_codes(void);

#endif
