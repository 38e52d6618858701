#include <string.h>

#include "mean.h"
#include "evidence.h"

/* Weighted sums over the models of each lane. */
typedef struct {
    Lanes mean[3 * MAX_ORDERS];                    /* (3, orders): of derivatives */
    Lanes covariance[2 * MAX_ORDERS * MAX_ORDERS]; /* (2, orders, orders): lower triangles */
    Lanes parameters;
} Sums;

/* Write to `variance` (2) the weights of a group in the covariance, times the variances of the
   noise; 0 without weight. Returns whether the group has any weight or probability. */
static inline int
weigh_variances(const Models *m, const Set *set, long long group, Lanes *variance)
{
    double any = 0.0;
    for (int c = 0; c < 2; c++) {
        variance[c] = set->covariance_weight[c * m->groups + group];
        any += sum_of(variance[c]) + sum_of(set->probability[c * m->groups + group]);
        /* The variance of a lane without a model need not be a number. */
        for (int i = 0; i < LANES; i++)
            if (((double *)(variance + c))[i] != 0.0)
                ((double *)(variance + c))[i] *=
                    ((double *)(set->variance + c * m->groups + group))[i];
    }
    return any != 0.0;
}

/* Add the derivatives of a group's models with all of `number` sets to the sums, weighted, and
   their covariances. Writes `derivatives` and `is_used` of the sets. */
static inline void
add_group(const Models *m, const Stencils *stencils, long long group, const Work *w, Set *sets,
          int number, Sums *sums)
{
    long long orders = stencils->orders, square = orders * orders;
    Lanes without_columns[3 * MAX_ORDERS];
    int is_computed = 0;
    for (int n = 0; n < number; n++) {
        Set *set = sets + n;
        Lanes variance[2], *derivatives = set->derivatives + group * 3 * orders;
        set->is_used[group] = weigh_variances(m, set, group, variance);
        if (!set->is_used[group])
            continue;
        if (!is_computed) {
            memset(without_columns, 0, 3 * orders * sizeof(Lanes));
            Columns samples = {w->coefficients, 3}, modes = {stencils->modes, orders};
            add_mode_products(m, m->shrinkage, group, samples, modes, w->terms, without_columns);
        }
        is_computed = 1;
        memcpy(derivatives, without_columns, 3 * orders * sizeof(Lanes));
        Lanes parameters = m->parameters[group];
        FOR_VECTORS parameters.part[h] += (double)(set->steps > 0);
        sums->parameters = multiply_add(sums->parameters, set->probability[group], parameters);
        for (int c = 0; c < 2; c++)
            for (long long k = 0; k < square; k++)
                sums->covariance[c * square + k] =
                    multiply_add(sums->covariance[c * square + k], variance[c],
                                 stencils->covariance[group * square + k]);
        if (set->columns)
            correct_for_columns(m, stencils, group, w, set, variance, derivatives,
                                sums->covariance);
        for (long long k = 0; k < 3 * orders; k++)
            sums->mean[k] = multiply_add(sums->mean[k],
                                         set->probability[(k >= orders) * m->groups + group],
                                         derivatives[k]);
    }
}

/* Add the weighted variance between the models of a set, about the mean, to the lower triangles of
   `covariance` (2, orders, orders). That of the position is the mean of both coordinates. The
   `derivatives` of the set become deviations. */
static inline void
add_disagreement(const Models *m, long long orders, const Set *set, const Estimate *estimate,
                 Lanes *covariance)
{
    for (long long g = 0; g < m->groups; g++)
        for (int c = 0; c < (set->is_used[g] ? 3 : 0); c++)
            for (long long k = 0; k < orders; k++) {
                Lanes *deviations = set->derivatives + (g * 3 + c) * orders, weighted;
                FOR_VECTORS deviations[k].part[h] -= estimate->mean[c][k];
                weighted = product(set->covariance_weight[(c > 0) * m->groups + g], deviations[k]);
                weighted = scaled(weighted, c ? 0.5 : 1.0);
                for (long long j = 0; j <= k; j++) {
                    Lanes *sum = covariance + ((c > 0) * orders + k) * orders + j;
                    *sum = multiply_add(*sum, weighted, deviations[j]);
                }
            }
}

PRIVATE void
differentiate(const Models *m, const Stencils *stencils, const Work *w, Set *sets, int number,
              Estimate *out)
{
    long long orders = stencils->orders, square = orders * orders;
    Sums sums;
    memset(&sums, 0, sizeof sums);
    for (int c = 0; c < 2; c++) {
        out->evidence[c] = find_probabilities(m, c, sets, number);
        find_covariance_weights(m, c, sets, number);
        out->event[c] = 0.0;
        for (long long g = 0; g < (number > 1 ? m->groups : 0); g++)
            out->event[c] += sum_of(sets[1].probability[c * m->groups + g]);
    }
    for (long long g = 0; g < m->groups; g++)
        add_group(m, stencils, g, w, sets, number, &sums);
    for (long long k = 0; k < 3 * orders; k++)
        out->mean[k / orders][k % orders] = sum_of(sums.mean[k]);
    for (int n = 0; n < number; n++)
        add_disagreement(m, orders, sets + n, out, sums.covariance);
    out->parameters = sum_of(sums.parameters), out->hub = 0.0;
    for (int c = 0; c < 2; c++) {
        for (long long k = 0; k < orders; k++)
            for (long long j = 0; j <= k; j++)
                out->covariance[c][k][j] = out->covariance[c][j][k] =
                    sum_of(sums.covariance[(c * orders + k) * orders + j]);
        for (int n = 1; n < number; n++) {
            double weight = 0.0;
            for (long long g = 0; g < m->groups; g++)
                weight += sum_of(sets[n].covariance_weight[c * m->groups + g]);
            for (long long k = 0; k < square; k++)
                out->covariance[c][k / orders][k % orders] +=
                    weight * sets[n].place_covariance[c][k / orders][k % orders];
        }
    }
}

/* Add to `error` (low_samples, 3) by how much the samples of low weight of a set without steps
   exceed their prediction from the other samples, in the mean of all models. `over_pivots` is
   scratch. */
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
move_to_grid(const Models *m, const Lanes *slopes, const Samples *uneven, const Samples *placed,
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
                power *= uneven->off[t] / (k + 1);
                sum += power * (t == near ? even + odd : k % 2 ? even - odd : odd - even);
            }
            moved[c][t] = uneven->x[c][t] - sum;
        }
    double *error = w->terms;
    memset(error, 0, 3 * set->low_samples * sizeof(double));
    add_prediction_errors(m, w, set, error);
    for (long long x = 0; x < set->low_samples; x++)
        for (int c = 0; c < 3; c++)
            if (set->weight[x] <= 0.0 &&
                set->weight[(set->parts - 1) * set->low_samples + x] <= 0.0)
                moved[c][set->low_sample[x]] = placed->x[c][set->low_sample[x]] - error[3 * x + c];
}
