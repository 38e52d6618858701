#include <string.h>

#include "models.h"
#include "lanes.h"

PRIVATE_INLINE void
add_table_products(const Lanes *table, long long depth, const double *values, long long stride,
                   long long columns, Lanes *out, long long step)
{
    for (; columns >= 3; columns -= 3, values += 3 * stride, out += 3 * step) {
        Lanes x = out[0], y = out[step], z = out[2 * step];
        for (long long k = 0; k < depth; k++) {
            FOR_VECTORS x.part[h] += table[k].part[h] * values[k];
            FOR_VECTORS y.part[h] += table[k].part[h] * values[stride + k];
            FOR_VECTORS z.part[h] += table[k].part[h] * values[2 * stride + k];
        }
        out[0] = x, out[step] = y, out[2 * step] = z;
    }
    for (; columns > 0; columns--, values += stride, out += step) {
        Lanes x = out[0];
        for (long long k = 0; k < depth; k++)
            FOR_VECTORS x.part[h] += table[k].part[h] * values[k];
        out[0] = x;
    }
}

PRIVATE_INLINE void
add_mode_products(const Models *m, const Lanes *table, long long group, const double *left,
                  long long a, const double *right, long long b, double *terms, Lanes *out)
{
    const long long *first = m->first_row + group / m->chunks;
    table += group % m->chunks * m->rows;
    for (int parity = 0; parity < 2; parity++, first += m->processes + 1) {
        long long begin = first[0], depth = first[1] - begin, columns = 0;
        for (long long i = 0; i < a; i++)
            for (long long j = 0; j < (right ? b : i + 1); j++, columns++) {
                const double *x = left + i * m->rows + begin;
                const double *y = (right ? right : left) + j * m->rows + begin;
                for (long long k = 0; k < depth; k++)
                    terms[columns * depth + k] = x[k] * y[k];
            }
        add_table_products(table + begin, depth, terms, depth, columns, out, 1);
    }
}

PRIVATE_INLINE void
fold(const Models *m, double *const *signals, long long columns, double *folded)
{
    long long n = m->count, half = m->half;
    for (long long c = 0; c < columns; c++)
        for (long long t = 0; t < half; t++) {
            double a = signals[c][t], b = signals[c][n - 1 - t];
            folded[c * half + t] = a + b, folded[(columns + c) * half + t] = a - b;
        }
}

PRIVATE_INLINE void
project(const Models *m, const double *folded, long long columns, long long begin, long long end,
        double *coefficients)
{
    for (long long r = begin / LANES * LANES; r < end; r += LANES) {
        for (long long c = 0; c < columns; c++)
            memset(coefficients + c * m->rows + r, 0, LANES * sizeof(double));
        add_table_products(m->basis + r / LANES * m->half, m->half,
                           folded + (r < m->first_odd ? 0 : columns * m->half), m->half, columns,
                           (Lanes *)(coefficients + r), m->rows / LANES);
    }
}
