/*
 * Structs whose fields Python fills and reads.
 *
 * The fields of such a struct are a list, which is a macro of three others:
 *
 *   #define SLOTS_FIELDS(VALUE, BLOCK, ARRAY)               \
 *       VALUE(double, scale, "m: the unit of the points")   \
 *       BLOCK(double, basis, 9, "rows e1, e2 and normal")   \
 *       ARRAY(const long long, row_of_slot, "(S)", "the point of each slot")
 *   typedef STRUCT(SLOTS_FIELDS) Slots;
 *
 * A VALUE is in the struct, a BLOCK is so many of them, and an ARRAY points to the elements of an
 * array of numpy of this shape. The last argument is what the field is, after its unit, if it has
 * one. The codes of an enum are such a list too:
 *
 *   #define QUANTITY_FLAGS(CODE) \
 *       CODE(DETERMINED, 1)      \
 *       CODE(MOVES, 2)
 *   enum { QUANTITY_FLAGS(DECLARE_CODE) };
 *
 * structs.c describes all lists, and bindings.py makes its classes of these descriptions, so no
 * field and no code is typed twice. docs/structs.md shows them.
 */

#ifndef KINPOLE_STRUCTS_H
#define KINPOLE_STRUCTS_H

#include <complex.h>

typedef double complex Number;
/* 0 or 1: a bool of numpy. */
typedef unsigned char Flag;

#define DECLARE_VALUE(type, name, meaning) type name;
#define DECLARE_BLOCK(type, name, count, meaning) type name[count];
#define DECLARE_ARRAY(type, name, shape, meaning) type *name;
#define STRUCT(FIELDS)                                      \
    struct {                                                \
        FIELDS(DECLARE_VALUE, DECLARE_BLOCK, DECLARE_ARRAY) \
    }
#define DECLARE_CODE(name, value) name = value,

/* A function that Python calls: the library exports no others. */
#ifdef _WIN32
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

/* A field: its type as it is written, the shape of an ARRAY, what it is, the number of a BLOCK, 0
   for a VALUE, -1 for an ARRAY, and the byte at which it begins. */
typedef struct {
    const char *name, *type, *shape, *meaning;
    long long count, offset;
} Field;

/* A struct: its length, bytes, and its fields. */
typedef struct {
    const char *name;
    long long size, count;
    const Field *fields;
} Description;

typedef struct {
    const char *name;
    long long value;
} Code;

/* An enum: its codes. */
typedef struct {
    const char *name;
    long long count;
    const Code *codes;
} Codes;

/* Return the descriptions of all structs, and of all enums that Python reads. A struct that has
   another one as a field comes after it. The last of a list has no name. */
API const Description *kinpole_structs(void);
API const Codes *kinpole_codes(void);

#endif
