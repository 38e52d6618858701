#include <string.h>

#include "moving.h"
#include "evidence.h"
#include "lanes.h"
#include "models.h"
#include "samples.h"
#include "sets.h"

/* Add to `error` (cells, 3) by how much samples at the cells exceed their prediction from the other
   samples, in the mean of all models. */
static inline void
add_prediction_errors(const Models *m, const Work *w, const Set *set, double *error)
{
    long long number = set->columns, pairs = number * (number + 1) / 2;
    for (long long g = 0; g < m->groups; g++)
        for (int c = 0; c < (set->is_used[g] ? 3 : 0); c++) {
            long long part = set->parts > 1 && c > 0;
            const Lanes *factor = set->factors + (g * set->parts + part) * pairs;
            const Lanes *residual = set->residuals + (g * 3 + c) * number;
            Lanes *size = w->over_pivots;
            /* The sizes of the columns are root times L'^-1 D^-1 residual, by back substitution. */
            for (long long x = number - 1; x >= 0; x--) {
                size[x] = product(residual[x], factor[x * (x + 3) / 2]);
                for (long long k = x + 1; k < number; k++)
                    size[x] = multiply_subtract(size[x], factor[k * (k + 1) / 2 + x], size[k]);
                error[x * 3 + c] += set->root[part * number + x] *
                    sum_of(product(size[x], set->probability[(c > 0) * m->groups + g]));
            }
        }
}

PRIVATE void
move_to_grid(const Models *m, const Lanes *slopes, const Samples *given, const Samples *placed,
             Work *w, Set *set, double *const moved[3])
{
    long long rows = m->rows, n = m->count, panels = (m->half + LANES - 1) / LANES;
    project_samples(m, placed, w);
    evaluate_models(m, placed, w, set);
    for (int c = 0; c < 2; c++)
        find_probabilities(m, c, set, 1);
    /* Derivatives (2, SLOPE_ORDERS, 3, panels) of the even and of the odd part of the motion. */
    double *motion = w->squares;
    memset(w->slopes, 0, 2 * SLOPE_ORDERS * 3 * panels * sizeof(Lanes));
    for (long long g = 0; g < m->groups; g++) {
        const Lanes probability[2] = {set->probability[g], set->probability[m->groups + g]};
        set->is_used[g] = sum_of(probability[0]) != 0.0 || sum_of(probability[1]) != 0.0;
        for (int parity = 0; parity < (set->is_used[g] ? 2 : 0); parity++) {
            const long long *first = m->first_row + parity * (m->processes + 1) + g / m->chunks;
            for (long long r = first[0]; r < first[1]; r++) {
                Lanes shrinkage = m->shrinkage[g % m->chunks * rows + r];
                double of_angle = sum_of(product(shrinkage, probability[0]));
                double of_position = sum_of(product(shrinkage, probability[1]));
                for (int c = 0; c < 3; c++)
                    motion[c * rows + r] =
                        (c ? of_position : of_angle) * w->coefficients[c * rows + r];
            }
            Lanes *out = w->slopes + parity * SLOPE_ORDERS * 3 * panels;
            for (long long k = 0; k < SLOPE_ORDERS * panels; k++)
                add_table_products(slopes + k * rows + first[0], first[1] - first[0],
                                   motion + first[0], rows, 3,
                                   out + k / panels * 3 * panels + k % panels, panels);
        }
    }
    for (int c = 0; c < 3; c++)
        for (long long t = 0; t < n; t++) {
            long long near = t < m->half ? t : n - 1 - t;
            double power = 1.0, sum = 0.0;
            for (int k = 0; k < SLOPE_ORDERS; k++) {
                double even = ((double *)(w->slopes + (k * 3 + c) * panels))[near];
                double odd = ((double *)(w->slopes + ((SLOPE_ORDERS + k) * 3 + c) * panels))[near];
                /* The first and the third derivative of an even function are odd. */
                power *= given->off[t] / (k + 1);
                sum += power * (t == near ? even + odd : k % 2 ? even - odd : odd - even);
            }
            moved[c][t] = given->x[c][t] - sum;
        }
    double *error = w->terms;
    memset(error, 0, 3 * set->cells * sizeof(double));
    add_prediction_errors(m, w, set, error);
    for (long long x = 0; x < set->cells; x++)
        for (int c = 0; c < 3; c++)
            if (set->weight[x] <= 0.0 && set->weight[(set->parts - 1) * set->cells + x] <= 0.0)
                moved[c][set->cell[x]] = placed->x[c][set->cell[x]] - error[3 * x + c];
}
