#include <math.h>
#include <string.h>

#include "evidence.h"
#include "numbers.h"

/* Models with a smaller weight in the covariance, or a smaller probability, are skipped: the result
   changes by less than this. */
#define MIN_WEIGHT 1e-5
#define MIN_PROBABILITY 1e-8
/* Models this far below the best in log evidence are skipped: exp(-25) is below both. */
#define MAX_EVIDENCE_LOSS 50.0
/* Loss of log evidence after which shorter lengths of a spectrum are skipped in sets with events:
   their evidence is lower still. */
#define LENGTH_EVIDENCE_LOSS 8.0
/* Bound of the number of spectra, of which _models.py has three. */
#define MAX_SPECTRA 8

/* Solve L y = root values in place, (number) of each, with L D L' of `factorize`, its `factor`.
   Writes y / D to `over_pivots` (number). */
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

/* Factorize diag(weight) + diag(root) C diag(root) = L D L', for the products C (pairs) of `number`
   columns. Writes `factor` (pairs): L, with 1 / D on its diagonal. Returns half of the log
   determinant. */
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

/* Add to `reduction` (3) by how much the columns reduce the residual sums of squares of a group's
   models. Writes to `logs` (2) half of what they add to the log determinant, and `factors` and
   `residuals` of the set (matrix inversion lemma: Rasmussen and Williams, A.3). */
static inline void
apply_columns(const Models *m, long long group, const Work *w, const Set *set, Lanes *reduction,
              Lanes *logs)
{
    long long number = set->columns, pairs = number * (number + 1) / 2, all = pairs + 3 * number;
    /* b' P b of columns and b' P x of samples, with the inverse P of the model's covariance. */
    Lanes *products = w->column_products;
    memset(products, 0, all * sizeof(Lanes));
    Columns columns = {set->coefficients, number}, samples = {w->coefficients, 3}, none = {NULL, 0};
    add_mode_products(m, m->residual_factor, group, columns, none, w->terms, products);
    add_mode_products(m, m->residual_factor, group, samples, columns, w->terms, products + pairs);
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
correct_for_columns(const Models *m, const Stencils *stencils, long long group, const Work *w,
                    const Set *set, const Lanes *variance, Lanes *derivatives, Lanes *covariance)
{
    long long orders = stencils->orders, number = set->columns, pairs = number * (number + 1) / 2;
    Lanes *effects = w->column_effects + orders * number;
    memset(effects, 0, orders * number * sizeof(Lanes));
    Columns modes = {stencils->modes, orders}, columns = {set->coefficients, number};
    add_mode_products(m, m->shrinkage, group, modes, columns, w->terms, effects);
    for (long long k = 0; k < orders; k++)
        for (long long x = set->low_samples; x < number; x++) {
            const Step *step = set->step + x - set->low_samples;
            if (k <= step->order)
                FOR_VECTORS effects[k * number + x].part[h] -=
                    step_value(step->order - k, stencils->at - step->place);
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
                Lanes element = all_lanes(0.0);
                for (long long x = 0; x < number; x++)
                    element = multiply_add(element, effect[x], w->over_pivots[j * number + x]);
                for (int c = 0; c < 2; c++)
                    if (set->parts == 1 || part == c) {
                        Lanes *sum = covariance + (c * orders + k) * orders + j;
                        *sum = multiply_add(*sum, variance[c], element);
                    }
            }
        }
    }
}

PRIVATE void
project_samples(const Models *m, const Samples *s, Work *w)
{
    for (int c = 0; c < 3; c++) {
        w->sum_of_squares[c] = 0.0;
        for (long long t = 0; t < m->count; t++)
            w->sum_of_squares[c] += s->x[c][t] * s->x[c][t];
    }
    fold(m, s->x, 3, w->terms);
    project(m, w->terms, 3, 0, m->rows, w->coefficients);
    for (long long i = 0; i < 3 * m->rows; i++)
        w->squares[i] = w->coefficients[i] * w->coefficients[i];
    memset(w->residual, 0, 3 * m->groups * sizeof(Lanes));
    for (long long g = 0; g < m->groups; g++) {
        const long long *first = m->first_row + g / m->chunks;
        for (int parity = 0; parity < 2; parity++, first += m->processes + 1)
            add_table_products(m->residual_factor + g % m->chunks * m->rows + first[0],
                               first[1] - first[0], w->squares + first[0], m->rows, 3,
                               w->residual + g, m->groups);
        for (int c = 0; c < (m->exact ? 0 : 3); c++)
            FOR_VECTORS w->residual[c * m->groups + g].part[h] =
                w->sum_of_squares[c] - w->residual[c * m->groups + g].part[h];
    }
}

/* Compute the variance of the noise and the log evidence of a group's models, of angle (c = 0) or
   position (c = 1), from their `residual` sums of squares (2) and the half log determinants of
   columns, `logs` (2). Writes both to the set; returns the best evidence. */
static inline double
evaluate_group(const Models *m, const Work *w, long long group, int c, const Lanes *residual,
               const Lanes *logs, Set *set)
{
    double number = w->prior_samples + w->total_weight[c] * (c + 1), best = -INFINITY;
    double *evidence = (double *)(set->evidence + c * m->groups + group);
    double *variance = (double *)(set->variance + c * m->groups + group);
    for (int i = 0; i < LANES; i++) {
        variance[i] = (((double *)(residual + c))[i] + w->prior_samples) / number;
        evidence[i] = ((const double *)(m->log_prior + c * m->groups + group))[i] -
            number / 2 * log(variance[i]) - ((double *)(logs + c))[i] * (c + 1) + set->log_prior;
        best = larger(best, evidence[i]);
    }
    return best;
}

PRIVATE void
evaluate_models(const Models *m, const Samples *s, const Work *w, Set *set)
{
    double top[2] = {-INFINITY, -INFINITY};
    int dropped = 0;
    if (set->columns)
        find_column_products(m, s, set);
    set->best_evidence[0] = set->best_evidence[1] = -INFINITY;
    for (long long g = 0; g < m->groups; g++) {
        Lanes residual[3], reduction[3], logs[2];
        int lower = 1;
        if (set->steps) {
            if (g && m->spectrum[g * LANES] != m->spectrum[(g - 1) * LANES])
                top[0] = top[1] = -INFINITY, dropped = 0;
            if (dropped) {
                set->evidence[g] = set->evidence[m->groups + g] = all_lanes(-INFINITY);
                set->variance[g] = set->variance[m->groups + g] = all_lanes(1.0);
                continue;
            }
            project_steps(m, g / m->chunks, set);
        }
        memset(reduction, 0, sizeof reduction), memset(logs, 0, sizeof logs);
        if (set->columns)
            apply_columns(m, g, w, set, reduction, logs);
        for (int c = 0; c < 3; c++) {
            FOR_VECTORS residual[c].part[h] =
                w->residual[c * m->groups + g].part[h] - reduction[c].part[h];
            for (int i = 0; i < LANES; i++)
                if (((double *)(residual + c))[i] < 0.0)
                    ((double *)(residual + c))[i] = 0.0;
        }
        FOR_VECTORS residual[1].part[h] += residual[2].part[h];
        for (int c = 0; c < 2; c++) {
            double best = evaluate_group(m, w, g, c, residual, logs, set);
            if (g < m->body_begin || g >= m->body_end)
                set->best_evidence[c] = larger(set->best_evidence[c], best);
            lower &= best < top[c] - LENGTH_EVIDENCE_LOSS;
            top[c] = larger(top[c], best);
        }
        dropped = lower && m->spectrum[g * LANES] < m->spectra;
    }
    for (int c = 0; c < 2; c++)
        for (long long g = m->body_begin; g < m->body_end; g++) {
            Lanes *evidence = set->evidence + c * m->groups + g;
            set->of_body[c][g - m->body_begin] = *evidence;
            *evidence = all_lanes(-INFINITY);
        }
}

PRIVATE void
add_body(const Models *m, Set *sets, int number)
{
    for (int n = 0; n < number; n++)
        for (int c = 0; c < 2; c++) {
            Lanes *evidence = sets[n].evidence + c * m->groups;
            memcpy(evidence + m->body_begin, sets[n].of_body[c],
                   (m->body_end - m->body_begin) * sizeof(Lanes));
            ((double *)(evidence + (m->processes - 1) * m->chunks))[0] += m->of_rest[c];
        }
}

PRIVATE double
find_probabilities(const Models *m, int c, Set *sets, int number)
{
    long long models = m->groups * LANES;
    double best = -INFINITY, sum = 0.0;
    for (int n = 0; n < number; n++)
        for (long long i = 0; i < models; i++)
            best = larger(best, ((double *)(sets[n].evidence + c * m->groups))[i]);
    for (int n = 0; n < number; n++) {
        const double *evidence = (const double *)(sets[n].evidence + c * m->groups);
        double *probability = (double *)(sets[n].probability + c * m->groups);
        for (long long i = 0; i < models; i++) {
            int is_skipped = evidence[i] < best - MAX_EVIDENCE_LOSS;
            probability[i] = is_skipped ? 0.0 : exp(evidence[i] - best);
            /* A comparison with NaN is false, so NaN reaches the result. */
            if (probability[i] < MIN_PROBABILITY)
                probability[i] = 0.0;
            sum += probability[i];
        }
    }
    for (int n = 0; n < number; n++)
        for (long long i = 0; i < models; i++)
            ((double *)(sets[n].probability + c * m->groups))[i] /= sum;
    return best + log(sum);
}

PRIVATE void
find_covariance_weights(const Models *m, int c, Set *sets, int number)
{
    long long models = m->groups * LANES, common = m->spectra;
    double top[MAX_SPECTRA + 1], total[MAX_SPECTRA + 1] = {0}, highest = -INFINITY;
    for (long long k = 0; k <= common; k++)
        top[k] = -INFINITY;
    for (int n = 0; n < number; n++) {
        const double *evidence = (const double *)(sets[n].evidence + c * m->groups);
        for (long long i = 0; i < models; i++)
            top[m->spectrum[i]] = larger(top[m->spectrum[i]], evidence[i] - sets[n].log_prior / 2);
    }
    for (long long k = 0; k <= common; k++)
        highest = larger(highest, top[k]);
    /* A common model is skipped only if it is far below the best of every spectrum. */
    double lowest = INFINITY;
    for (long long k = 0; k < common; k++)
        if (top[k] > -INFINITY) { /* otherwise the spectrum does not count for this signal */
            top[k] = larger(top[k], top[common]);
            lowest = smaller(lowest, top[k]);
        }
    top[common] = lowest;
    for (int n = 0; n < number; n++) {
        const double *evidence = (const double *)(sets[n].evidence + c * m->groups);
        double *weight = (double *)(sets[n].covariance_weight + c * m->groups);
        for (long long i = 0; i < models; i++) {
            double value = evidence[i] - sets[n].log_prior / 2;
            long long k = m->spectrum[i];
            weight[i] = value < top[k] - MAX_EVIDENCE_LOSS ? 0.0 : exp((value - highest) / 2);
            total[k] += weight[i];
        }
    }
    double of_common = 0.0, sum = 0.0;
    for (long long k = 0; k < common; k++) {
        total[k] += total[common];
        total[k] = top[k] > -INFINITY && total[k] > 1e-300 ? 1.0 / total[k] : 0.0;
        of_common += total[k];
    }
    total[common] = of_common;
    for (int n = 0; n < number; n++) {
        double *weight = (double *)(sets[n].covariance_weight + c * m->groups);
        for (long long i = 0; i < models; i++)
            sum += weight[i] *= total[m->spectrum[i]];
    }
    for (int n = 0; n < number; n++) {
        double *weight = (double *)(sets[n].covariance_weight + c * m->groups);
        for (long long i = 0; i < models; i++) {
            weight[i] /= sum;
            if (weight[i] < MIN_WEIGHT)
                weight[i] = 0.0;
        }
    }
}
