#include <stddef.h>
#include <string.h>

#include "models.h"
#include "memory.h"
#include "numbers.h"

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
add_mode_products(const Models *m, const Lanes *table, long long group, Columns left, Columns right,
                  double *terms, Lanes *out)
{
    const long long *first = m->first_row + group / m->chunks;
    table += group % m->chunks * m->rows;
    for (int parity = 0; parity < 2; parity++, first += m->processes + 1) {
        long long begin = first[0], depth = first[1] - begin, columns = 0;
        for (long long i = 0; i < left.count; i++)
            for (long long j = 0; j < (right.count ? right.count : i + 1); j++, columns++) {
                const double *x = left.values + i * m->rows + begin;
                const double *y = (right.count ? right : left).values + j * m->rows + begin;
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

PRIVATE size_t
size_of_set(const Models *m, long long orders, long long columns, long long steps, int parts)
{
    long long pairs = columns * (columns + 1) / 2;
    long long of_lanes = m->groups * (8 + 3 * orders + parts * pairs + 3 * columns);
    long long of_numbers = steps * (m->count + 2 * m->half) + columns * (m->rows + 8) + pairs +
                           m->groups;
    return 8 * (of_lanes * LANES + of_numbers);
}

PRIVATE char *
lay_out_set(const Models *m, long long orders, long long columns, long long steps, int parts,
            char *data, Set *set)
{
    long long pairs = columns * (columns + 1) / 2;
    *set = (Set){.columns = columns, .parts = parts};
    TAKE(set->evidence, 2 * m->groups), TAKE(set->variance, 2 * m->groups);
    TAKE(set->probability, 2 * m->groups), TAKE(set->covariance_weight, 2 * m->groups);
    TAKE(set->derivatives, 3 * orders * m->groups), TAKE(set->factors, parts * pairs * m->groups);
    TAKE(set->residuals, 3 * columns * m->groups);
    TAKE(set->step_columns, steps * m->count), TAKE(set->folded, steps * 2 * m->half);
    TAKE(set->coefficients, columns * m->rows);
    TAKE(set->column_products, pairs + 3 * columns), TAKE(set->weight, 2 * columns);
    TAKE(set->root, 2 * columns), TAKE(set->low_sample, columns), TAKE(set->is_used, m->groups);
    return data;
}

PRIVATE void
fill_step_column(const Step *step, long long count, long long block, double *column)
{
    for (long long t = 0; t < count; t++) {
        column[t] = 0.0;
        for (long long k = 0; k < block; k++) {
            double offset = (k - (block - 1) / 2.0) / block;
            column[t] += step_value(step->order, t + offset - step->place) / block;
        }
    }
}

PRIVATE void
project_low_samples(const Models *m, Set *set)
{
    for (long long x = 0; x < set->low_samples; x++) {
        long long at = set->low_sample[x], opposite = m->count - 1 - at;
        long long near = at < opposite ? at : opposite;
        double even = at == opposite ? 2.0 : 1.0, odd = at > opposite ? -1.0 : 1.0;
        for (long long r = 0; r < m->rows; r++)
            set->coefficients[x * m->rows + r] = (r < m->first_odd ? even : odd) *
                ((const double *)(m->basis + r / LANES * m->half + near))[r % LANES];
    }
}

PRIVATE void
project_steps(const Models *m, long long process, Set *set)
{
    for (int parity = 0; parity < 2; parity++) {
        const long long *first = m->first_row + parity * (m->processes + 1) + process;
        project(m, set->folded, set->steps, first[0], first[1],
                set->coefficients + set->low_samples * m->rows);
    }
}

PRIVATE void
find_column_products(const Models *m, const Samples *s, Set *set)
{
    long long number = set->columns, low = set->low_samples, n = m->count;
    double *out = set->column_products;
    for (long long i = 0; i < number + 3; i++)
        for (long long j = 0; j < (i < number ? i + 1 : number); j++) {
            if (i < low) {
                *out++ = i == j;
                continue;
            }
            const double *row = i < number ? set->step_columns + (i - low) * n : s->x[i - number];
            *out++ = j < low ? row[set->low_sample[j]]
                             : dot(row, set->step_columns + (j - low) * n, n);
        }
}
