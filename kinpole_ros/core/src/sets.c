#include <stddef.h>

#include "sets.h"
#include "lanes.h"
#include "memory.h"
#include "models.h"
#include "numbers.h"
#include "samples.h"

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
    TAKE(set->root, 2 * columns), TAKE(set->cell, columns), TAKE(set->is_used, m->groups);
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
project_cells(const Models *m, Set *set)
{
    for (long long x = 0; x < set->cells; x++) {
        long long at = set->cell[x], opposite = m->count - 1 - at;
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
                set->coefficients + set->cells * m->rows);
    }
}

PRIVATE void
find_column_products(const Models *m, const Samples *s, Set *set)
{
    long long number = set->columns, cells = set->cells, n = m->count;
    double *out = set->column_products;
    for (long long i = 0; i < number + 3; i++)
        for (long long j = 0; j < (i < number ? i + 1 : number); j++) {
            if (i < cells) {
                *out++ = i == j;
                continue;
            }
            const double *row = i < number ? set->step_columns + (i - cells) * n : s->x[i - number];
            *out++ = j < cells ? row[set->cell[j]]
                               : dot(row, set->step_columns + (j - cells) * n, n);
        }
}
