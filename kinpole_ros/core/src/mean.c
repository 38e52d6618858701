#include <string.h>

#include "mean.h"
#include "columns.h"
#include "evidence.h"
#include "lanes.h"
#include "models.h"
#include "sets.h"

/* Sums over models: derivatives (3, orders), covariances (2, orders, orders), and parameters. */
typedef struct {
    Lanes mean[3 * MAX_ORDERS], spread[2 * MAX_ORDERS * MAX_ORDERS], freedom[2];
} Sums;

/* Multiply the weights of a group in the covariance by the variances of the noise, into `variance`
   (2). Returns whether the group has any weight or probability. */
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

/* Add the derivatives of a group with all sets to the sums, weighted, and their covariances. */
static inline void
add_group(const Models *m, const Stencils *s, long long group, const Work *w, Set *sets, int number,
          Sums *sums)
{
    long long orders = s->orders, square = orders * orders;
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
            add_mode_products(m, m->shrinkage, group, w->coefficients, 3, s->modes, orders,
                              w->terms, without_columns);
        }
        is_computed = 1;
        memcpy(derivatives, without_columns, 3 * orders * sizeof(Lanes));
        for (int c = 0; c < 2; c++) {
            Lanes freedom = m->freedom[group];
            FOR_VECTORS freedom.part[h] += (double)set->events;
            sums->freedom[c] = multiply_add(sums->freedom[c],
                                            set->probability[c * m->groups + group], freedom);
            for (long long k = 0; k < square; k++)
                sums->spread[c * square + k] = multiply_add(
                    sums->spread[c * square + k], variance[c], s->spread[group * square + k]);
        }
        if (set->columns)
            correct_for_columns(m, s, group, w, set, variance, derivatives, sums->spread);
        for (long long k = 0; k < 3 * orders; k++)
            sums->mean[k] = multiply_add(sums->mean[k],
                                         set->probability[(k >= orders) * m->groups + group],
                                         derivatives[k]);
    }
}

/* Add the weighted variance between the models, about the mean, to the covariances. That of the
   position is the mean of both coordinates. */
static inline void
add_disagreement(const Models *m, long long orders, const Set *set, const Estimate *estimate,
                 Lanes *spread)
{
    for (long long g = 0; g < m->groups; g++)
        for (int c = 0; c < (set->is_used[g] ? 3 : 0); c++)
            for (long long k = 0; k < orders; k++) {
                Lanes *deviations = set->derivatives + (g * 3 + c) * orders, weighted;
                FOR_VECTORS deviations[k].part[h] -= estimate->mean[c][k];
                weighted = product(set->covariance_weight[(c > 0) * m->groups + g], deviations[k]);
                weighted = scaled(weighted, c ? 0.5 : 1.0);
                for (long long j = 0; j <= k; j++) {
                    Lanes *sum = spread + ((c > 0) * orders + k) * orders + j;
                    *sum = multiply_add(*sum, weighted, deviations[j]);
                }
            }
}

PRIVATE void
differentiate(const Models *m, const Stencils *s, const Work *w, Set *sets, int number,
              Estimate *out)
{
    long long orders = s->orders, square = orders * orders;
    Sums sums;
    memset(&sums, 0, sizeof sums);
    for (int c = 0; c < 2; c++)
        find_probabilities(m, c, sets, number), find_covariance_weights(m, c, sets, number);
    for (long long g = 0; g < m->groups; g++)
        add_group(m, s, g, w, sets, number, &sums);
    for (long long k = 0; k < 3 * orders; k++)
        out->mean[k / orders][k % orders] = sum_of(sums.mean[k]);
    for (int n = 0; n < number; n++)
        add_disagreement(m, orders, sets + n, out, sums.spread);
    for (int c = 0; c < 2; c++) {
        out->freedom[c] = sum_of(sums.freedom[c]);
        for (long long k = 0; k < orders; k++)
            for (long long j = 0; j <= k; j++)
                out->covariance[c][k][j] = out->covariance[c][j][k] =
                    sum_of(sums.spread[(c * orders + k) * orders + j]);
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
