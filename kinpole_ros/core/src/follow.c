/*
 * The loop from the markers of frames to derivatives, which live and replay share.
 *
 * An unusual frame ends the loop, and is taken in Python. The result of a frame is computed when it is
 * due, from the window of frames up to the newest.
 */

#include <math.h>
#include <string.h>

#include "fit.h"
#include "memory.h"
#include "numbers.h"
#include "rejection.h"

/* The poses of a window, and their derivatives. `heading` is the angle of the body, and `angle` that by
   which its hub moves: the heading plus what a tilted body turns beyond it. */
typedef struct {
    double *angle, *heading, *turn_information, *place_information, *derivatives;
    Number *position, *hub;
    long long frames[3];
} Poses;

/* A result is due this share of an interval before its frame is as old as the lag. */
static const double EARLY = 0.75;

static Number
unit_at(double angle)
{
    return cos(angle) + I * sin(angle);
}

/* Number of frames in the history with a time before `at`, ns. */
static long long
number_before(const Frames *f, long long at)
{
    long long low = f->first, high = f->end;
    while (low < high) {
        long long middle = (low + high) / 2;
        if (f->time[middle] < at)
            low = middle + 1;
        else
            high = middle;
    }
    return low - f->first;
}

/* Whether the next frame follows the newest without a gap. */
static int
next_goes_on(const Frames *f)
{
    return f->end == f->first || f->interval == 0 ||
        f->new_time[f->frame] - f->time[f->end - 1] <= f->gap * f->interval;
}

/* Fits `markers` (B, n) of the next frame into the row after the newest; what is unusual. */
int
kinpole_try_frame(Frames *f, const Number *markers)
{
    int goes_on = next_goes_on(f);
    f->end++;
    int found = kinpole_fit_frame(f, markers, goes_on);
    f->end--;
    return found;
}

/* How far a body turned about the normal beyond the change of its heading, rad, between two tilts at
   the begin and the end of a rotation with constant angular velocity. The heading is the twist about
   the normal in the swing-twist decomposition. While a body is tilted, its rate is not the angular
   velocity along the normal, and the integral of the difference depends on the path: it does not
   return to zero with the pose. The result is 0 where either tilt is not known. */
static double
extra_turn(Number before, Number after, double heading)
{
    double rest = 1.0 - square_of(before), cosine = sqrt(rest > 0.0 ? rest : 0.0);
    double rest_after = 1.0 - square_of(after), after_cosine = sqrt(rest_after > 0.0 ? rest_after : 0.0);
    double turn = heading - TURN * floor(heading / TURN + 0.5);
    /* The quaternion of the rotation has the parts w + i z, `along`, and |x + i y|, `across`. */
    Number ahead = cosine * after_cosine + after * conj(before);
    Number along = ahead * unit_at(0.5 * turn);
    double across = cabs(cosine * after - after_cosine * before), sine = hypot(cimag(along), across);
    double half = atan2(sine, creal(along)) * (cimag(along) / sine);
    double extra = 2.0 * carg(ahead) + 2.0 * (half - carg(along));
    return isnan(extra) ? 0.0 : extra;
}

/* Adds what tilting bodies turn beyond their headings to the newest row; only poses that are certainly
   right count for the rows after it. */
static void
follow_tilts(const Frames *f, const Number *tilts)
{
    for (long long b = 0; b < f->bodies; b++) {
        long long at = (f->end - 1) * f->bodies + b;
        double angle = f->angle[at];
        double turned = extra_turn(f->sure_tilt[b], tilts[b], angle - f->sure_angle[b]);
        f->extra_turn[at] = f->total_turn[b] + turned;
        if (!isnan(angle) && f->newest[b] == 0)
            f->total_turn[b] = f->extra_turn[at], f->sure_angle[b] = angle, f->sure_tilt[b] = tilts[b];
    }
}

/* Notes that a body is seen, and the gap before if it was as long as a window. */
static void
note_seen(const Frames *f, long long b, long long stamp)
{
    long long since = f->seen_last[b], lasted = stamp - since, *outage = f->outages + OUTAGE_FIELDS * b;
    f->seen_last[b] = stamp;
    if (since < 0 || lasted < f->window)
        return;
    outage[OUTAGE_LATEST] = since, outage[OUTAGE_LATEST + 1] = lasted;
    if (!outage[OUTAGE_TIMES]++ || lasted > outage[OUTAGE_LONGEST + 1])
        outage[OUTAGE_LONGEST] = since, outage[OUTAGE_LONGEST + 1] = lasted;
}

/* Takes the next frame, if it is usual or was corrected. */
static int
take_frame(Frames *f)
{
    long long all = f->bodies * f->width, row = f->end, k = f->frame;
    const Number *points = f->points + k * all, *fitted = f->corrected ? f->corrected : points;
    const double *heights = f->point_heights + k * all;
    if (f->hidden_is_unusual && !f->corrected)
        for (long long i = 0; i < all; i++)
            if (isnan(creal(points[i])))
                return UNUSUAL;
    int goes_on = next_goes_on(f);
    f->end++;
    if (kinpole_fit_frame(f, fitted, goes_on && !f->corrected) && !f->corrected) {
        f->end--;
        return UNUSUAL;
    }
    f->corrected = NULL;
    f->stamp[row] = f->new_stamp[k], f->time[row] = f->new_time[k], f->count[row] = f->new_count[k];
    f->goes_on[row] = goes_on;
    memcpy(f->markers + row * all, points, all * sizeof *points);
    memcpy(f->heights + row * all, heights, all * sizeof *heights);
    for (long long b = 0; b < f->bodies; b++) {
        double sum = 0.0;
        long long seen = 0;
        for (long long i = b * f->width; i < (b + 1) * f->width; i++)
            if (!isnan(creal(fitted[i])))
                sum += heights[i], seen++;
        f->height[row * f->bodies + b] = seen ? sum / seen : NAN;
        f->extra_turn[row * f->bodies + b] = 0.0;
    }
    kinpole_unwrap(f);
    kinpole_follow_paths(f);
    if (f->tilts)
        follow_tilts(f, f->tilts + k * f->bodies);
    for (long long b = 0; b < f->bodies; b++)
        if (!isnan(f->angle[row * f->bodies + b]))
            note_seen(f, b, f->stamp[row]);
        else
            f->held[b] += kinpole_is_held(f, b, points + b * f->width);
    f->frame++, f->until_update--;
    return DONE;
}

/* Computes the poses of the hubs in the window from `oldest` on; whether any body tilts. */
static int
fill_window(const Frames *f, long long oldest, Poses *poses)
{
    int tilts = 0;
    for (long long i = oldest * f->bodies; f->posed && i < f->end * f->bodies; i++)
        tilts |= f->extra_turn[i] != 0.0;
    for (long long row = oldest; row < f->end; row++)
        for (long long b = 0; b < f->bodies; b++) {
            long long at = row * f->bodies + b, to = at - oldest * f->bodies;
            const double *information = f->information + 2 * row * f->bodies + b;
            double turned = information[0] * f->scale[b];
            double placed = information[f->bodies] * f->scale[f->bodies + b], growth = 0.0;
            Number hub = poses->hub[b], position = f->position[at];
            poses->heading[to] = f->angle[at];
            poses->angle[to] = f->angle[at] + (tilts ? f->extra_turn[at] - f->tilt_turn[b] : 0.0);
            if (hub != 0.0) {
                position += hub * unit_at(poses->angle[to]);
                /* The variance at the hub is that at the middle of the markers, plus that of the angle
                   times the squared distance. With hidden markers the fit is about another middle, so
                   the first may come out negative. */
                if (placed > 0.0) {
                    double ratio = placed / turned;
                    growth = 1.0 - square_of(f->middle[b]) * ratio;
                    growth = (growth > 0.0 ? growth : 0.0) + square_of(hub - f->middle[b]) * ratio;
                }
            }
            poses->position[to] = position;
            poses->turn_information[to] = turned;
            poses->place_information[to] = growth > 0.0 ? placed / growth : placed;
        }
    return tilts;
}

/* The weighted mean of the markers used in a row, in the frame of the body. */
static Number
middle_of_used(const Frames *f, long long row, long long b)
{
    Number sum = 0.0;
    double total = 0.0;
    for (long long k = 0; k < f->width; k++)
        if (f->used[(row * f->bodies + b) * f->width + k]) {
            double weight = f->weights[b * f->width + k];
            sum += weight * f->shape[b * f->width + k], total += weight;
        }
    return total > 0.0 ? sum / total : NAN;
}

/* Copies the derivatives of one instant into the results; NaN for bodies without any. */
static void
copy_derivatives(const Frames *f, const Call *call, Results *r)
{
    long long orders = call->orders, bodies = f->bodies, t = r->count;
    const double *from = call->results;
    double *to = r->derivatives;
    const unsigned char *reason = r->reason + t * bodies;
    for (long long k = 0; k < 2 * orders + 2 * orders * orders + 2; k++) {
        long long size = k < orders ? 2 : 1;
        for (long long i = 0; i < size * bodies; i++)
            to[t * size * bodies + i] = reason[i / size] > NOT_FULL ? NAN : from[i];
        from += size * bodies, to += r->instants * size * bodies;
    }
}

/* Replaces the angles by those of the headings of tilted bodies, and turns the hubs into their axes. */
static int
derive_headings(Call *call, Poses *poses)
{
    long long bodies = call->bodies;
    /* The published angle is the heading; the hub is turned into its axes. */
    double *angle = poses->derivatives + 2 * call->orders * bodies;
    for (long long b = 0; b < bodies; b++)
        poses->hub[b] *= isnan(angle[b]) ? 1.0 : unit_at(angle[b]);
    call->angle = poses->heading, call->next = 0;
    long long size = (3 * call->orders + 2 * call->orders * call->orders + 2) * bodies;
    call->results = poses->derivatives + size;
    int code = kinpole_derive(call);
    if (code)
        return code;
    const double *heading = call->results + 2 * call->orders * bodies;
    for (long long b = 0; b < bodies; b++) {
        poses->hub[b] *= isnan(heading[b]) ? 1.0 : conj(unit_at(heading[b]));
        angle[b] = heading[b];
    }
    call->results = poses->derivatives;
    return DONE;
}

/* Computes the result of the frame in row `now` from the window of those from `oldest` on. */
static int
compute_result(const Frames *f, Call *call, Results *r, Poses *poses, long long oldest, long long now)
{
    long long bodies = f->bodies, newest = f->end - 1, t = r->count, deforms = 0;
    for (long long b = 0; b < bodies; b++) {
        long long to = t * bodies + b;
        int pinned = kinpole_holds_on_pin(f, oldest, b);
        r->pin[to] = pinned ? f->pin[b] : NAN + I * NAN;
        r->pin_variance[to] = pinned ? f->pin_variance[b] : NAN;
        poses->hub[b] = pinned ? 0.0 : f->hub[b];
    }
    int tilts = fill_window(f, oldest, poses);
    call->frames = f->end - oldest, call->bodies = bodies;
    poses->frames[0] = now - oldest, poses->frames[1] = 0, poses->frames[2] = newest - oldest;
    call->time = f->time + oldest, call->turns = f->turns + oldest * bodies;
    call->windows = poses->frames, call->left_out = f->newest;
    call->angle = poses->angle, call->position = (const double *)poses->position;
    call->angle_information = poses->turn_information;
    call->position_information = poses->place_information;
    call->noise = f->noise, call->results = poses->derivatives, call->next = 0;
    int code = kinpole_derive(call);
    if (code)
        return code;
    if (tilts && (code = derive_headings(call, poses)))
        return code;
    for (long long b = 0; b < bodies; b++) {
        long long at = now * bodies + b, to = t * bodies + b, orders = call->orders;
        const double *information = f->information + 2 * now * bodies + b;
        int missing = kinpole_reason(f, now, b), seen = missing < NOT_SEEN;
        const double *rate = poses->derivatives + (2 * orders + 1) * bodies + b;
        const double *velocity = poses->derivatives + 2 * (bodies + b);
        int found = isfinite(*rate) && isfinite(velocity[0]) && isfinite(velocity[1]);
        r->reason[to] = missing ? missing : found ? KNOWN : NOT_FULL;
        r->size[to] = f->size[b], r->height[to] = f->height[at];
        r->reference[to] = poses->hub[b];
        r->frame_angle[to] = f->angle[at] + TURN * f->turns[at];
        r->frame_position[to] = f->position[at];
        r->noise[to] = f->noise[b];
        r->middle[to] = f->posed ? f->middle[b] : middle_of_used(f, now, b);
        for (int c = 0; c < 2; c++)
            r->information[(2 * t + c) * bodies + b] =
                seen ? information[c * bodies] * f->scale[c * bodies + b] : 0.0;
        deforms |= r->reason[to] == KNOWN && f->freedom[b] > 0.0;
    }
    copy_derivatives(f, call, r);
    memcpy(r->shape + t * bodies * f->width, f->known_shape,
           bodies * f->width * sizeof *r->shape);
    r->stamp[t] = f->stamp[now], r->due[t] = f->frame - 1;
    r->rows[3 * t] = now - f->first, r->rows[3 * t + 1] = oldest - f->first;
    r->rows[3 * t + 2] = newest - f->first;
    r->count++, r->deformed += deforms;
    return DONE;
}

/* Computes the results that are due with the newest frame. */
static int
compute_due(Frames *f, Call *call, Results *r)
{
    if (f->end == f->first)
        return DONE;
    long long newest = f->end - 1, oldest;
    oldest = f->first + number_before(f, f->time[newest] - f->window);
    f->samples = newest - oldest + 1;
    f->interval = (double)(f->time[newest] - f->time[oldest]) / (f->samples > 1 ? f->samples - 1 : 1);
    long long latest = f->time[newest] - (long long)rint(f->lag - EARLY * f->interval);
    long long end = number_before(f, latest + 1);
    int code = DONE;
    if (f->due < end && r->instants && newest - oldest >= r->fewest - 1) {
        if (f->first + f->due < oldest)
            f->due = oldest - f->first;
        /* Twice the space for derivatives: bodies that tilt have two angles. */
        long long all = (f->end - oldest) * f->bodies;
        long long derivatives = 2 * (3 * call->orders + 2 * call->orders * call->orders + 2) * f->bodies;
        Poses poses;
        double *data = kinpole_buffer(
            call, OF_POSES, (6 * all + derivatives + 2 * f->bodies) * sizeof *data);
        if (!data)
            return NO_MEMORY;
        poses.position = (Number *)data, poses.hub = (Number *)(data + 2 * all);
        poses.angle = data + 2 * all + 2 * f->bodies, poses.heading = poses.angle + all;
        poses.turn_information = poses.heading + all;
        poses.place_information = poses.turn_information + all;
        poses.derivatives = poses.place_information + all;
        for (; !code && f->due < end; ) {
            if (r->count == r->instants) {
                code = FULL;
                break;
            }
            code = compute_result(f, call, r, &poses, oldest, f->first + f->due);
            if (code == DONE)
                f->due++;
        }
        if (code)
            return code;
    }
    f->due = end > f->due ? end : f->due;
    return DONE;
}

/* Takes frames while they are usual, and computes the results that are due. Returns DONE, or why it has
   to be called again after step.py has done its part. */
int
kinpole_follow(Frames *f, Call *call, Results *r)
{
    for (;;) {
        int code = compute_due(f, call, r);
        if (code || f->frame == f->frames || f->until_update <= 0)
            return code;
        code = take_frame(f);
        if (code)
            return code;
    }
}
