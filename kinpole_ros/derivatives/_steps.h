/*
 * Events: where derivatives step within a window, as an impact or a drive makes them.
 *
 * Candidates are screened with few models, the likeliest of the window without the steps: how much
 * better they explain the samples with a step follows for all places and orders from sums over the
 * residuals. The evidence of all models is computed for the best candidates only.
 */

/* Steps of the motion itself, of its first and of its second derivative are looked for. */
#define ORDERS 3
/* Columns of an event at most. */
#define COLUMNS 3
/* Events that are looked for in a window, one after the other. */
#define MOST_EVENTS 2
/* Only windows are searched of which even the likeliest model has less evidence than a line by so
   many flat priors of a parameter. */
#define WORTH 3
/* How probable it is that a window has an event, of any order at any sample. */
#define EVENT_PRIOR 0.05
/* The logarithm of the part of all sizes that is as large as the one estimated. */
#define SIZE_COST 2.4
/* A candidate has at least so much more evidence by the models that screen it. */
#define LEAST_GAIN 8.0
/* Candidates of another order have so much less evidence at most. */
#define BEHIND 3.0
/* A second event that gains so much makes the set without it not count. */
#define SURE_GAIN 25.0
/* Events have so many samples on either side. */
#define EDGE 3
/* Standard deviation of the place of an event, samples, at least and at most. */
#define LEAST_PLACE 0.5
#define MOST_PLACE 3.0
/* The power of the evidence by which events at other places count in covariances. */
#define POWER 0.25
/* Places of a chance below exp(-this) do not count. */
#define LEAST_CHANCE 7.0
/* Other places are looked at if one may be so near to the instant, samples. */
#define NEAR 12
/* Steps are screened with the likeliest of all models, and of the slowest of each spectrum. */
#define SLOWEST 2
/* A step of which less is left is one that is in the set. */
#define LEFT_OF_STEP 1e-6

/* The samples of angle (c 0) or position (c 1) as a model with some columns explains them:
   `residual` (c + 1, count), its `sums` by steps at all places (ORDERS, count), of the squares of which
   is `explained`, and how much of the steps themselves is `left`. `removed` (columns, count) are the columns as the
   model leaves them, without those before, and `factor` by how much they are removed. */
typedef struct {
    int c;
    long long model, columns;
    double squares, *residual, *sums, *explained, *left, *removed, *factor;
} Screen;

/* Screens of angle and position, and by these how much evidence a step of each order at each place
   (ORDERS, count) gains, but for what its size costs. `reach` (2, orders, count) are the samples'
   weights in derivatives at the instant, if `reached`. */
typedef struct {
    Screen of[2];
    double *gain, *reach;
    int reached;
} Screens;

/* An event after the sample before `sample` by models that screen it. */
typedef struct {
    double value, gain;
    long long sample;
    Screens *screens;
} Candidate;

/* The number of the likeliest model of a set, or of its slow models. */
static long long
find_likeliest(const Models *m, const Set *set, int c, int slow)
{
    const double *evidence = (const double *)(set->evidence + c * m->groups);
    long long process = m->chunks * LANES, best = 0;
    for (long long k = 0; k < m->groups * LANES; k++) {
        /* Processes of a spectrum are in the order of their lengths. */
        int fast = k >= SLOWEST * process && m->kind[k - SLOWEST * process] == m->kind[k];
        int allowed = slow ? m->kind[k] < m->kinds - 1 && !fast : m->kind[k] != m->kinds - 1;
        if (allowed && evidence[k] > evidence[best])
            best = k;
    }
    return best;
}

/* What a model leaves of a signal (count) that has such modes. */
static void
leave(const Models *m, long long model, const double *modes, const double *signal, Lanes *sums,
      double *left)
{
    long long group = model / LANES, lane = model % LANES, n = m->count;
    const double *share = (const double *)(m->share + group % m->chunks * m->rows) + lane;
    const long long *first = m->first + group / m->chunks;
    memcpy(left, signal, n * sizeof(double));
    for (int parity = 0; parity < 2; parity++, first += m->processes + 1) {
        memset(sums, 0, m->half * sizeof(Lanes));
        for (long long r = first[0] / LANES * LANES; r < first[1]; r += LANES) {
            Lanes factor = all_lanes(0.0);
            for (long long k = r > first[0] ? r : first[0]; k < r + LANES && k < first[1]; k++)
                ((double *)&factor)[k - r] = share[k * LANES] * modes[k];
            for (long long t = 0; t < m->half; t++)
                sums[t] = plus(sums[t], factor, m->panels[r / LANES * m->half + t]);
        }
        for (long long t = 0; t < m->half; t++) {
            double sum = sum_of(sums[t]);
            left[t] -= t == n - 1 - t ? 2 * sum : sum;
            if (t != n - 1 - t)
                left[n - 1 - t] -= parity ? -sum : sum;
        }
    }
}

/* Compute how a column (count) with such modes is left, to be the next of those removed. Returns how
   much of it is left, and the root of the mean square of its product with the residuals. */
static double
measure(const Models *m, Screen *screen, const double *column, const double *modes, Lanes *sums,
        double *along)
{
    long long n = m->count;
    double *own = screen->removed + screen->columns * n, square = 0.0;
    leave(m, screen->model, modes, column, sums, own);
    for (long long k = 0; k < screen->columns; k++) {
        const double *other = screen->removed + k * n;
        double by = screen->factor[k] * dot(other, column, n);
        for (long long t = 0; t < n; t++)
            own[t] -= by * other[t];
    }
    for (int j = 0; j <= screen->c; j++) {
        double product = dot(column, screen->residual + j * n, n);
        square += product * product / (screen->c + 1);
    }
    *along = sqrt(square);
    double left = dot(column, own, n);
    return left > LEFT_OF_STEP * LEFT_OF_STEP * dot(column, column, n) ? left : 0.0;
}

/* Remove the column that was measured last, of which so much is left. */
static void
remove_measured(const Models *m, Screen *screen, const Samples *s, double left, double weight,
                double root)
{
    long long n = m->count;
    const double *own = screen->removed + screen->columns * n;
    double factor = root > 0.0 ? root * root / (weight + root * root * left) : 0.0;
    for (int j = 0; j <= screen->c; j++) {
        double by = factor * dot(own, s->x[screen->c + j], n);
        for (long long t = 0; t < n; t++)
            screen->residual[j * n + t] -= by * own[t];
    }
    screen->factor[screen->columns++] = factor;
}

/* Sums (ORDERS, count) of a signal times steps half a sample before each sample. */
static void
sum_by_steps(const double *signal, long long count, double *sums)
{
    /* Of the signal times binomial coefficients of the time since. */
    double a = 0.0, b = 0.0, c = 0.0;
    for (long long k = count - 1; k >= 0; k--) {
        c += b, b += a, a += signal[k];
        sums[k] = a;
        sums[count + k] = b + a / 2;
        sums[2 * count + k] = c + b + a / 8;
    }
}

/* Remove the columns of a set that a screen has not yet, and screen steps at all places. */
static void
screen_steps(const Models *m, const Samples *s, const Work *w, const Set *set, Screen *screen,
             double *spare)
{
    long long n = m->count, part = set->parts > 1 && screen->c > 0;
    Lanes *sums = w->off;
    const double *whole = m->unexplained + screen->model * ORDERS * n;
    for (long long x = screen->columns; x < set->columns; x++) {
        const double *column = spare;
        double along, weight = set->weight[part * set->columns + x];
        if (x < set->cells)
            memset(spare, 0, n * sizeof(double)), spare[set->at[x]] = 1.0;
        else
            column = set->values + (x - set->cells) * n;
        double left = measure(m, screen, column, set->vectors + x * m->rows, sums, &along);
        remove_measured(m, screen, s, left, weight, set->root[part * set->columns + x]);
        sum_by_steps(screen->removed + x * n, n, screen->explained);
        for (long long k = 0; k < ORDERS * n; k++)
            screen->left[k] -= screen->factor[x] * screen->explained[k] * screen->explained[k];
    }
    memset(screen->explained, 0, ORDERS * n * sizeof(double));
    screen->squares = 0.0;
    for (int j = 0; j <= screen->c; j++) {
        screen->squares += dot(screen->residual + j * n, s->x[screen->c + j], n);
        double *sums = screen->sums + j * ORDERS * n;
        sum_by_steps(screen->residual + j * n, n, sums);
        for (long long k = 0; k < ORDERS * n; k++)
            screen->explained[k] += sums[k] * sums[k];
    }
    screen->squares = larger(screen->squares, 0.0);
    for (long long k = 0; k < ORDERS * n; k++)
        screen->left[k] = screen->left[k] > LEFT_OF_STEP * whole[k] ? screen->left[k] : INFINITY;
}

/* Begin to screen with a model. */
static void
begin_screen(const Models *m, const Samples *s, const Work *w, long long model, Screen *screen)
{
    long long n = m->count;
    screen->model = model, screen->columns = 0;
    for (int j = 0; j <= screen->c; j++)
        leave(m, model, w->modes + (screen->c + j) * m->rows, s->x[screen->c + j], w->off,
              screen->residual + j * n);
    memcpy(screen->left, m->unexplained + model * ORDERS * n, ORDERS * n * sizeof(double));
}

/* How much of the squares a step of the estimated size explains. */
static inline double
explained_of(const Screen *screen, long long k, double *square)
{
    *square = screen->explained[k] / screen->left[k] / (screen->c + 1);
    return (screen->c + 1) * *square * *square / (1 + *square);
}

/* How much more evidence there is by the model with a step of the estimated size. */
static double
gain_of(const Screen *screen, const Work *w, long long k)
{
    double square, explained = explained_of(screen, k, &square), before = screen->squares + w->known;
    double number = w->known + w->seen[screen->c] * (screen->c + 1);
    double after = larger(before - explained, w->known);
    return larger(number / 2 * log(before / after) - (screen->c + 1) * log(1 + square) / 2, 0.0);
}

/* Find the best place of a step of each order. Gains are ranked by a rational approximation of their
   logarithm. */
static void
find_candidates(const Models *m, const Work *w, double value, Screens *screens, Candidate *best)
{
    long long n = m->count;
    memset(screens->gain, 0, ORDERS * n * sizeof(double));
    for (int c = 0; c < 2; c++) {
        const Screen *screen = screens->of + c;
        double per = 1 / (c + 1.0), all = 1 / (screen->squares + w->known);
        double number = (w->known + w->seen[c] * (c + 1)) / 2;
        for (long long k = 0; k < ORDERS * n; k++) {
            double square = screen->explained[k] / screen->left[k] * per;
            double part = smaller((c + 1) * all * square * square / (1 + square), 1.0);
            screens->gain[k] += number * part * (6 - part) / (6 - 4 * part);
        }
    }
    for (int order = 0; order < ORDERS; order++) {
        long long at = order * n + EDGE;
        for (long long k = at; k <= (order + 1) * n - EDGE; k++)
            if (screens->gain[k] > screens->gain[at])
                at = k;
        double gain = gain_of(screens->of, w, at) + gain_of(screens->of + 1, w, at);
        Candidate one = {value + gain, gain, at - order * n, screens};
        if (one.value > best[order].value)
            best[order] = one;
    }
}

/* The order of the best candidate. */
static int
find_best(const Candidate *candidates)
{
    int best = 0;
    for (int k = 1; k < ORDERS; k++)
        best = candidates[k].value > candidates[best].value ? k : best;
    return best;
}

/* Find the deviations of the columns that were added to a set for an event of an order, one after the
   other, as the model of a screen estimates them. */
static void
find_sizes(const Models *m, const Screen *screen, Set *set, int order, double *spare)
{
    long long n = m->count, begin = set->from->steps, number = set->steps - begin, c = screen->c;
    long long group = screen->model / LANES, lane = screen->model % LANES;
    const double *columns = set->values + begin * n;
    const double *modes = set->vectors + (set->cells + begin) * m->rows;
    double *weight = set->weight + c * set->columns + set->cells + begin;
    double *root = set->root + c * set->columns + set->cells + begin, place = LEAST_PLACE;
    double between[COLUMNS][COLUMNS], square[COLUMNS], along[2][COLUMNS];
    const double *share = (const double *)(m->share) + lane;
    find_modes_of_steps(m, group, set);
    for (int k = 0; k < number; k++) {
        for (int l = 0; l <= k; l++)
            between[k][l] = dot(columns + k * n, columns + l * n, n);
        square[k] = between[k][k];
        for (int j = 0; j <= c; j++)
            along[j][k] = dot(columns + k * n, screen->residual + j * n, n);
    }
    for (int parity = 0; parity < 2; parity++) {
        const long long *first = m->first + parity * (m->processes + 1) + group;
        for (long long r = first[0]; r < first[1]; r++)
            for (int k = 0; k < number; k++)
                for (int l = 0; l <= k; l++)
                    between[k][l] -= share[r * LANES] * modes[k * m->rows + r] *
                        modes[l * m->rows + r];
    }
    for (long long x = 0; x < screen->columns; x++) {
        for (int k = 0; k < number; k++)
            spare[k] = dot(columns + k * n, screen->removed + x * n, n);
        for (int k = 0; k < number; k++)
            for (int l = 0; l <= k; l++)
                between[k][l] -= screen->factor[x] * spare[k] * spare[l];
    }
    for (int k = 0; k < number; k++) {
        int each = set->step[begin + k].order;
        double left = between[k][k] > LEFT_OF_STEP * LEFT_OF_STEP * square[k] ? between[k][k] : 0.0;
        double size = 0.0;
        for (int j = 0; j <= c; j++)
            size += along[j][k] * along[j][k] / (c + 1);
        root[k] = left > 0.0 ? sqrt(size) / left : 0.0;
        if (each == order - 1) {
            double known = root[0] * sqrt((c + 1) * left);
            place = known > 0.0 ? smaller(larger(1 / known, LEAST_PLACE), MOST_PLACE) : LEAST_PLACE;
            root[k] = root[0] * place;
        }
        weight[k] = 1.0;
        double factor = root[k] * root[k] / (1.0 + root[k] * root[k] * left);
        for (int l = k + 1; l < number; l++) {
            for (int i = k + 1; i <= l; i++)
                between[l][i] -= factor * between[l][k] * between[i][k];
            for (int j = 0; j <= c; j++)
                along[j][l] -= factor * between[l][k] * along[j][k];
        }
    }
}

/* Copy a set, and add the columns of an event: the step, what it is if its place is somewhat earlier
   or later, and a step of the next derivative. Sizes are those that the screening models estimate.
   The set is laid out at `data`; returns what comes after it. */
static char *
extend_set(const Models *m, const Set *from, const Candidate *candidate, int order,
            long long orders, long long block, char *data,
           Set *set, double *spare)
{
    long long n = m->count, cells = from->cells, begin = from->steps, number = 1;
    /* The next derivative is the last: the other sizes are known then. */
    int each[COLUMNS] = {order};
    if (order)
        each[number++] = order - 1;
    each[number++] = order + 1;
    long long steps = begin + number, columns = cells + steps;
    data = lay_out_set(m, orders, columns, steps, 2, data, set);
    set->from = from, set->cells = cells, set->steps = steps, set->events = from->events + 1;
    set->prior = from->prior + log(EVENT_PRIOR / (1 - EVENT_PRIOR) / (ORDERS * n)) - SIZE_COST;
    memcpy(set->at, from->at, cells * sizeof *set->at);
    memcpy(set->step, from->step, sizeof set->step);
    memcpy(set->spread, from->spread, sizeof set->spread);
    memcpy(set->values, from->values, begin * n * sizeof(double));
    memcpy(set->vectors, from->vectors, from->columns * m->rows * sizeof(double));
    for (int part = 0; part < 2; part++) {
        long long there = part < from->parts ? part * from->columns : 0;
        memcpy(set->weight + part * columns, from->weight + there, from->columns * sizeof(double));
        memcpy(set->root + part * columns, from->root + there, from->columns * sizeof(double));
    }
    double *signals[MOST_STEPS];
    for (int k = 0; k < steps; k++)
        signals[k] = set->values + k * n;
    for (int k = 0; k < number; k++) {
        set->step[begin + k] = (Step){.place = candidate->sample - 0.5, .order = each[k]};
        find_values(set->step + begin + k, n, block, signals[begin + k]);
    }
    fold(m, signals, steps, set->folded);
    for (int c = 0; c < 2; c++)
        find_sizes(m, candidate->screens->of + c, set, order, spare);
    return data;
}

/* Compute the weights of samples in derivatives by the models of screens, with the columns of a set. */
static void
find_reach(const Models *m, const Stencils *by, const Set *set, Screens *screens, Lanes *lanes)
{
    long long n = m->count, orders = by->orders;
    double *weights = screens->reach;
    memset(weights, 0, 2 * orders * n * sizeof(double));
    screens->reached = 1;
    for (long long k = 0; k < 2 * orders; k++, weights += n) {
        const Screen *screen = screens->of + k / orders;
        /* Less what the model makes of them. */
        leave(m, screen->model, by->modes + k % orders * m->rows, weights, lanes, weights);
        for (long long x = 0; x < screen->columns; x++) {
            double change;
            if (x < set->cells)
                change = weights[set->at[x]];
            else {
                const Step *step = set->step + x - set->cells;
                change = dot(weights, set->values + (x - set->cells) * n, n);
                if (k % orders <= step->order)
                    change += step_since(step->order - k % orders, by->at - step->place);
            }
            change *= screen->factor[x];
            for (long long t = 0; t < n; t++)
                weights[t] -= change * screen->removed[x * n + t];
        }
    }
}

/* Compute the covariance of derivatives that is due to the place of an event, by the models of its
   screens: as the event may be anywhere, with its chances there. */
static void
find_spread(const Models *m, const Stencils *by, const Set *from, const Candidate *candidate,
            int order, Lanes *lanes, double *spare, Set *set)
{
    long long n = m->count, orders = by->orders, places = n - 2 * EDGE + 1, best = 0;
    Screens *screens = candidate->screens;
    double *chance = spare, *sums = spare + n, total = 0.0;
    const double *gain = screens->gain + order * n + EDGE;
    int near = 0;
    for (long long k = 0; k < places; k++)
        best = gain[k] > gain[best] ? k : best;
    for (long long k = 0; k < places; k++) {
        double less = POWER * (gain[best] - gain[k]);
        chance[k] = less > LEAST_CHANCE ? 0.0 : exp(-less);
        near |= chance[k] > 0.0 && fabs(by->at - (k + EDGE - 0.5)) < NEAR;
        total += chance[k];
    }
    if (!near)
        return;
    if (!screens->reached)
        find_reach(m, by, from, screens, lanes);
    for (int c = 0; c < 2; c++) {
        const Screen *screen = screens->of + c;
        for (long long o = 0; o < orders; o++)
            sum_by_steps(screens->reach + (c * orders + o) * n, n, sums + o * ORDERS * n);
        for (int j = 0; j <= c; j++) {
            double middle[MOST_ORDERS] = {0.0};
            for (long long i = -1; i < places; i++) {
                /* About what is found with the event at its best place. */
                long long k = i < 0 ? best : i, at = order * n + k + EDGE;
                double off[MOST_ORDERS], square, size;
                if (chance[k] == 0.0)
                    continue;
                explained_of(screen, at, &square);
                size = screen->sums[j * ORDERS * n + at] / screen->left[at] * square / (1 + square);
                for (long long o = 0; o < orders; o++) {
                    double here = o > order ? 0.0 : step_since(order - o, by->at - (k + EDGE - 0.5));
                    off[o] = size * (here + sums[o * ORDERS * n + at]) - middle[o];
                }
                if (i < 0)
                    memcpy(middle, off, sizeof middle);
                for (long long o = 0; o < orders; o++)
                    for (long long p = 0; p < (i < 0 ? 0 : orders); p++)
                        set->spread[c][o][p] += chance[k] / total / (c + 1) * off[o] * off[p];
            }
        }
    }
}
