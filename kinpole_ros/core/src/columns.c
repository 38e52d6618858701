#include <math.h>
#include <string.h>

#include "columns.h"
#include "lanes.h"
#include "models.h"
#include "sets.h"

/* Solve L y = root values in place, with L D L' of `factorize`; `over_pivots` is y / D. */
static inline void
forward_substitute(const Lanes *factor, const double *root, long long number, Lanes *values,
                   Lanes *over_pivots)
{
    for (long long x = 0; x < number; x++) {
        Lanes sum = scaled(values[x], root[x]);
        for (long long k = 0; k < x; k++)
            sum = multiply_subtract(sum, *factor++, values[k]);
        values[x] = sum;
        over_pivots[x] = product(sum, *factor++);
    }
}

/* Factorize diag(weight) + diag(root) C diag(root) = L D L', for the products C (pairs) of columns;
   `factor` (pairs) is L, with 1 / D on its diagonal. Returns half of the log determinant. */
static inline Lanes
factorize(const Lanes *products, const double *weight, const double *root, long long number,
          Lanes *factor)
{
    Lanes logs = all_lanes(0.0), determinant = all_lanes(1.0);
    for (long long i = 0; i < number; i++) {
        const Lanes *covariance = products + i * (i + 1) / 2;
        Lanes *row = factor + i * (i + 1) / 2, diagonal = scaled(covariance[i], root[i] * root[i]);
        for (long long j = 0; j < i; j++) {
            const Lanes *other = factor + j * (j + 1) / 2;
            Lanes sum = scaled(covariance[j], root[i] * root[j]);
            for (long long k = 0; k < j; k++)
                sum = multiply_subtract(sum, row[k], other[k]);
            row[j] = sum;
        }
        FOR_VECTORS diagonal.part[h] += weight[i];
        /* Until now the row is L times D. */
        for (long long k = 0; k < i; k++) {
            Lanes before = row[k];
            row[k] = product(row[k], factor[k * (k + 3) / 2]);
            diagonal = multiply_subtract(diagonal, before, row[k]);
        }
        determinant = product(determinant, diagonal);
        FOR_VECTORS row[i].part[h] = 1.0 / diagonal.part[h];
        /* One logarithm for 8 columns: few calls, and no underflow of the product. */
        if (i % 8 == 7 || i == number - 1) {
            for (int l = 0; l < LANES; l++)
                ((double *)&logs)[l] += log(((double *)&determinant)[l]) / 2;
            determinant = all_lanes(1.0);
        }
    }
    return logs;
}

PRIVATE_INLINE void
apply_columns(const Models *m, long long group, const Work *w, const Set *set, Lanes *reduction,
              Lanes *logs)
{
    long long number = set->columns, pairs = number * (number + 1) / 2, all = pairs + 3 * number;
    /* b' P b of columns and b' P x of samples, with the inverse P of the model's covariance. */
    Lanes *products = w->column_products;
    memset(products, 0, all * sizeof(Lanes));
    add_mode_products(m, m->residual_factor, group, set->coefficients, number, NULL, 0, w->terms,
                      products);
    add_mode_products(m, m->residual_factor, group, w->coefficients, 3, set->coefficients, number,
                      w->terms, products + pairs);
    for (long long k = 0; k < (m->exact ? 0 : all); k++)
        FOR_VECTORS products[k].part[h] = set->column_products[k] - products[k].part[h];
    for (long long part = 0; part < set->parts; part++)
        logs[part] = factorize(products, set->weight + part * number, set->root + part * number,
                               number, set->factors + (group * set->parts + part) * pairs);
    if (set->parts == 1)
        logs[1] = logs[0];
    for (int c = 0; c < 3; c++) {
        long long part = set->parts > 1 && c > 0;
        Lanes *residual = set->residuals + (group * 3 + c) * number;
        memcpy(residual, products + pairs + c * number, number * sizeof(Lanes));
        forward_substitute(set->factors + (group * set->parts + part) * pairs,
                           set->root + part * number, number, residual, w->over_pivots);
        for (long long x = 0; x < number; x++)
            reduction[c] = multiply_add(reduction[c], residual[x], w->over_pivots[x]);
    }
}

PRIVATE_INLINE void
correct_for_columns(const Models *m, const Stencils *s, long long group, const Work *w,
                    const Set *set, const Lanes *variance, Lanes *derivatives, Lanes *spread)
{
    long long orders = s->orders, number = set->columns, pairs = number * (number + 1) / 2;
    Lanes *effects = w->column_effects + orders * number;
    memset(effects, 0, orders * number * sizeof(Lanes));
    add_mode_products(m, m->shrinkage, group, s->modes, orders, set->coefficients, number, w->terms,
                      effects);
    for (long long k = 0; k < orders; k++)
        for (long long x = set->cells; x < number; x++) {
            const Step *step = set->step + x - set->cells;
            if (k <= step->order)
                FOR_VECTORS effects[k * number + x].part[h] -=
                    step_value(step->order - k, s->at - step->place);
        }
    for (long long part = 0; part < set->parts; part++) {
        memcpy(w->column_effects, effects, orders * number * sizeof(Lanes));
        for (long long k = 0; k < orders; k++) {
            Lanes *effect = w->column_effects + k * number, *over = w->over_pivots + k * number;
            forward_substitute(set->factors + (group * set->parts + part) * pairs,
                               set->root + part * number, number, effect, over);
            for (int c = 0; c < 3; c++)
                for (long long x = 0; x < number && (set->parts == 1 || part == (c > 0)); x++)
                    derivatives[c * orders + k] =
                        multiply_subtract(derivatives[c * orders + k], over[x],
                                          set->residuals[(group * 3 + c) * number + x]);
            for (long long j = 0; j <= k; j++) {
                Lanes covariance = all_lanes(0.0);
                for (long long x = 0; x < number; x++)
                    covariance =
                        multiply_add(covariance, effect[x], w->over_pivots[j * number + x]);
                for (int c = 0; c < 2; c++)
                    if (set->parts == 1 || part == c) {
                        Lanes *sum = spread + (c * orders + k) * orders + j;
                        *sum = multiply_add(*sum, variance[c], covariance);
                    }
            }
        }
    }
}
