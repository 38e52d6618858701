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
#define COLUMNS 4
/* Events that are looked for in a window, one after the other. */
#define MOST_EVENTS 2
/* Only windows are searched of which even the likeliest model has less evidence than a line by so
   many flat priors of a parameter. */
#define WORTH 1
/* How probable it is that a window has an event, of any order at any sample. */
#define EVENT_PRIOR 0.05
/* The logarithm of the part of all sizes that is as large as the one estimated. */
#define SIZE_COST 2.4
/* A candidate has at least so much more evidence by the models that screen it. */
#define LEAST_GAIN 12.0
/* Candidates of another order have so much less evidence than the best at most. */
#define BEHIND 4.0
/* Another event is looked for if the last one has so much more evidence by all models. */
#define LEAST_PROGRESS 1.0
/* Events have so many samples on either side. */
#define EDGE 3
/* Standard deviation of the place of an event, samples, at least and at most. */
#define LEAST_PLACE 0.5
#define MOST_PLACE 3.0
/* By how many samples events of each order may be seen late, at least: an acceleration may set in
   gradually, and is taken for a step then. */
static const double least_off[ORDERS] = {0.0, 1.0, 3.0};
/* Steps are screened with the likeliest of all models, and of the slowest of each spectrum. */
#define SLOWEST 2
/* A step of which less is left is one that is in the set. */
#define LEFT_OF_STEP 1e-6

/* The samples of angle (c 0) or position (c 1) as a model with some columns explains them:
   `residual` (c + 1, count), how much of steps at all places (ORDERS, count) would be `explained`, and
   how much of the steps themselves is `left`. `removed` (columns, count) are the columns as the
   model leaves them, without those before, and `factor` by how much they are removed. */
typedef struct {
    int c;
    long long model, columns;
    double squares, *residual, *explained, *left, *removed, *factor;
} Screen;

/* An event after the sample before `sample` by models that screen it. */
typedef struct {
    double value, gain;
    long long sample;
    const Screen *screens;
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

/* Screen steps at all places with a model and the columns of a set. */
static void
screen_steps(const Models *m, const Samples *s, const Work *w, const Set *set, Screen *screen,
             double *spare)
{
    long long n = m->count, part = set->parts > 1 && screen->c > 0;
    Lanes *sums = w->off;
    screen->columns = 0;
    for (int j = 0; j <= screen->c; j++)
        leave(m, screen->model, w->modes + (screen->c + j) * m->rows, s->x[screen->c + j], sums,
              screen->residual + j * n);
    memcpy(screen->left, m->unexplained + screen->model * ORDERS * n, ORDERS * n * sizeof(double));
    for (long long x = 0; x < set->columns; x++) {
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
        sum_by_steps(screen->residual + j * n, n, spare);
        for (long long k = 0; k < ORDERS * n; k++)
            screen->explained[k] += spare[k] * spare[k];
    }
    screen->squares = larger(screen->squares, 0.0);
    const double *whole = m->unexplained + screen->model * ORDERS * n;
    for (long long k = 0; k < ORDERS * n; k++)
        screen->left[k] = screen->left[k] > LEFT_OF_STEP * whole[k] ? screen->left[k] : INFINITY;
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
find_candidates(const Models *m, const Work *w, const Set *set, const Screen *screens,
                Candidate *best)
{
    long long n = m->count;
    double value = 0.0;
    for (int c = 0; c < 2; c++)
        value += ((const double *)(set->evidence + c * m->groups))[screens[c].model];
    for (int order = 0; order < ORDERS; order++) {
        double most = -1.0;
        long long at = 0;
        for (long long k = order * n + EDGE; k <= (order + 1) * n - EDGE; k++) {
            double rank = 0.0, square;
            for (int c = 0; c < 2; c++) {
                double part = explained_of(screens + c, k, &square) /
                              (screens[c].squares + w->known);
                part = smaller(part, 1.0);
                rank += (w->known + w->seen[c] * (c + 1)) * part * (6 - part) / (6 - 4 * part);
            }
            if (rank > most)
                most = rank, at = k;
        }
        double gain = gain_of(screens, w, at) + gain_of(screens + 1, w, at);
        Candidate one = {value + gain, gain, at - order * n, screens};
        if (one.value > best[order].value)
            best[order] = one;
    }
}

/* Copy a set, and add the columns of an event: the step, what it is if its place is somewhat earlier
   or later, and a step of the next derivative. Sizes are those that the screening models estimate.
   The set is laid out at `data`; returns what comes after it. */
static char *
extend_set(const Models *m, const Samples *s, const Work *w, const Set *from,
           const Candidate *candidate, int order, long long orders, long long block, char *data,
           Set *set, double *spare)
{
    long long n = m->count, cells = from->cells, begin = from->steps, number = 1;
    /* The next derivative is the last: the other sizes are known then. */
    int each[COLUMNS] = {order};
    for (int k = order - 1; k >= 0; k--)
        each[number++] = k;
    each[number++] = order + 1;
    long long steps = begin + number, columns = cells + steps;
    data = lay_out_set(m, orders, columns, steps, 2, data, set);
    set->cells = cells, set->steps = steps, set->events = from->events + 1;
    set->prior = from->prior + log(EVENT_PRIOR / (1 - EVENT_PRIOR) / (ORDERS * n)) - SIZE_COST;
    memcpy(set->at, from->at, cells * sizeof *set->at);
    memcpy(set->step, from->step, sizeof set->step);
    memcpy(set->values, from->values, begin * n * sizeof(double));
    memcpy(set->vectors, from->vectors, from->columns * m->rows * sizeof(double));
    for (int part = 0; part < 2; part++) {
        long long there = part < from->parts ? part * from->columns : 0;
        memcpy(set->weight + part * columns, from->weight + there, from->columns * sizeof(double));
        memcpy(set->root + part * columns, from->root + there, from->columns * sizeof(double));
    }
    double *signals[COLUMNS], *modes = set->vectors + (cells + begin) * m->rows;
    for (int k = 0; k < number; k++) {
        set->step[begin + k] = (Step){.place = candidate->sample - 0.5, .order = each[k]};
        signals[k] = set->values + (begin + k) * n;
        find_values(set->step + begin + k, n, block, signals[k]);
    }
    find_modes(m, signals, number, w->terms, modes);
    for (int c = 0; c < 2; c++) {
        Screen screen = candidate->screens[c];
        double *weight = set->weight + c * columns + cells + begin;
        double *root = set->root + c * columns + cells + begin, place = LEAST_PLACE;
        screen.residual = spare;
        memcpy(spare, candidate->screens[c].residual, (c + 1) * n * sizeof(double));
        for (int k = 0; k < number; k++) {
            double along, left = measure(m, &screen, signals[k], modes + k * m->rows, w->off,
                                         &along);
            root[k] = left > 0.0 ? along / left : 0.0;
            if (each[k] == order - 1) {
                double known = root[0] * sqrt((c + 1) * left);
                place = known > 0.0 ? 1 / known : LEAST_PLACE;
                place = smaller(larger(place, LEAST_PLACE), MOST_PLACE);
                root[k] = root[0] * place;
                set->step[begin].size[c] = root[0];
                set->step[begin].off[c] = smaller(larger(1 / known, least_off[order]), MOST_PLACE);
            }
            if (each[k] == order - 2)
                root[k] = root[0] * place * place / 2;
            weight[k] = 1.0;
            remove_measured(m, &screen, s, left, weight[k], root[k]);
        }
    }
    return data;
}
