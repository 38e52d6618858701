/*
 * The loop from the markers of frames to derivatives, which live and replay share.
 *
 * An unusual frame ends the loop, and is taken in Python. The result of a frame is computed when it
 * is due, from the window of frames up to the newest. Arrays and shapes are those of frames.h: B
 * bodies with up to n markers. A row is one of the history, counted from the begin of its memory.
 */

#include <math.h>
#include <string.h>

#include "fit.h"
#include "memory.h"
#include "numbers.h"
#include "rejection.h"

/* The poses of the N frames of a window, as `Call` takes them. */
typedef struct {
    double *heading;              /* (N, B), rad: angle of the frame of the body */
    double *angle;                /* (N, B), rad: the heading, and `tilt_turn` of a tilted body */
    double *angle_information;    /* (N, B): squared noise over the variance; 0 if not used */
    double *position_information; /* (N, B): the same, of a coordinate of the position */
    Number *position;             /* (N, B), m: of the hubs */
    Number *hub;                  /* (B), m: point whose position is derived, in the body frame */
    long long windows[3];         /* of the instant, the oldest, and the newest, of the N */
} Poses;

/* A result is due this share of an interval before its frame is as old as the lag. */
static const double EARLY = 0.75;

/* The unit vector at an angle, rad. */
static Number
unit_at(double angle)
{
    return cos(angle) + I * sin(angle);
}

/* The number of frames in the history with a time before `at`, ns, by bisection. */
static long long
number_before(const Frames *f, long long at)
{
    const HistoryColumns *history = &f->history;
    long long low = history->first, high = history->end;
    while (low < high) {
        long long middle = (low + high) / 2;
        if (history->time[middle] < at)
            low = middle + 1;
        else
            high = middle;
    }
    return low - history->first;
}

/* Whether the next frame follows the newest without a gap: after `gap` intervals at most, or no
   interval is known yet. */
static int
next_goes_on(const Frames *f)
{
    const HistoryColumns *history = &f->history;
    return history->end == history->first || history->interval == 0 ||
        f->incoming.time[f->incoming.frame] - history->time[history->end - 1] <=
            f->limits.gap * history->interval;
}

int
kinpole_try_frame(Frames *f, const Number *markers)
{
    int goes_on = next_goes_on(f);
    f->history.end++;
    int found = kinpole_fit_frame(f, markers, goes_on);
    f->history.end--;
    return found;
}

/* How far a body turned about the normal beyond the change of its heading, rad, from the tilt
   `before` to the tilt `after`, while its heading changed by `heading`, rad, in a rotation with
   constant angular velocity. A tilt is x + i y of the quaternion of the swing, but for a factor i.
   The heading is the twist about the normal in the swing-twist decomposition. While a body is
   tilted, its rate is not the angular velocity along the normal, and the integral of the difference
   depends on the path: it does not return to zero with the pose. The result is 0 where either tilt
   is not known. */
static double
tilt_turn_between(Number before, Number after, double heading)
{
    double rest = 1.0 - square_of(before), cosine = sqrt(rest > 0.0 ? rest : 0.0);
    double rest_after = 1.0 - square_of(after);
    double after_cosine = sqrt(rest_after > 0.0 ? rest_after : 0.0);
    double turn = heading - TURN * floor(heading / TURN + 0.5);
    /* The quaternion of the rotation has the parts w + i z, `along`, and |x + i y|, `across`. */
    Number ahead = cosine * after_cosine + after * conj(before);
    Number along = ahead * unit_at(0.5 * turn);
    double across = cabs(cosine * after - after_cosine * before);
    double sine = hypot(cimag(along), across);
    double half = atan2(sine, creal(along)) * (cimag(along) / sine);
    double extra = 2.0 * carg(ahead) + 2.0 * (half - carg(along));
    return isnan(extra) ? 0.0 : extra;
}

/* Writes `tilt_turn` of the newest row, from the `tilts` (B) of its poses, after
   `kinpole_follow_paths`. It adds up from one pose that is surely right to the next, the `sure`
   tracks. */
static void
follow_tilts(const Frames *f, const Number *tilts)
{
    const HistoryColumns *history = &f->history;
    const BodyTracks *tracks = &f->tracks;
    for (long long b = 0; b < f->known.bodies; b++) {
        long long at = (history->end - 1) * f->known.bodies + b;
        double angle = history->angle[at];
        double heading = angle - tracks->sure_angle[b];
        double turned = tilt_turn_between(tracks->sure_tilt[b], tilts[b], heading);
        history->tilt_turn[at] = tracks->sure_tilt_turn[b] + turned;
        if (!isnan(angle) && tracks->left_out[b] == 0) {
            tracks->sure_tilt_turn[b] = history->tilt_turn[at];
            tracks->sure_angle[b] = angle;
            tracks->sure_tilt[b] = tilts[b];
        }
    }
}

/* Notes that body `b` has a pose at `stamp`, ns, in `seen_last`, and the gap before in `outages`,
   if it was as long as a window. */
static void
note_seen(const Frames *f, long long b, long long stamp)
{
    long long since = f->tracks.seen_last[b], lasted = stamp - since;
    Gaps *gaps = f->tracks.outages + b;
    f->tracks.seen_last[b] = stamp;
    if (since < 0 || lasted < f->limits.window_ns)
        return;
    gaps->latest_begin = since;
    gaps->latest_length = lasted;
    if (!gaps->times++ || lasted > gaps->longest_length) {
        gaps->longest_begin = since;
        gaps->longest_length = lasted;
    }
}

/* Copies the next frame into a row: times, markers and heights, and the mean height of the markers
   of each body that are seen in `fitted` (B, n). */
static void
copy_frame(const Frames *f, long long row, const Number *fitted)
{
    const HistoryColumns *history = &f->history;
    const NewFrames *incoming = &f->incoming;
    long long frame = incoming->frame, bodies = f->known.bodies, width = f->known.width;
    const double *heights = incoming->heights + frame * bodies * width;
    history->stamp[row] = incoming->stamp[frame];
    history->time[row] = incoming->time[frame];
    history->tick[row] = incoming->tick[frame];
    memcpy(history->markers + row * bodies * width, incoming->points + frame * bodies * width,
           bodies * width * sizeof *incoming->points);
    memcpy(history->heights + row * bodies * width, heights, bodies * width * sizeof *heights);
    for (long long b = 0; b < bodies; b++) {
        double sum = 0.0;
        long long seen = 0;
        for (long long i = b * width; i < (b + 1) * width; i++)
            if (!isnan(creal(fitted[i])))
                sum += heights[i], seen++;
        history->height[row * bodies + b] = seen ? sum / seen : NAN;
    }
}

/* Takes the next frame into the history, if it is usual or was corrected, and writes the tracks.
   Returns DONE, or UNUSUAL if it is not taken. */
static int
take_frame(Frames *f)
{
    HistoryColumns *history = &f->history;
    NewFrames *incoming = &f->incoming;
    long long bodies = f->known.bodies, width = f->known.width, all = bodies * width;
    long long row = history->end;
    const Number *points = incoming->points + incoming->frame * all;
    const Number *fitted = incoming->corrected ? incoming->corrected : points;
    if (incoming->hidden_is_unusual && !incoming->corrected)
        for (long long i = 0; i < all; i++)
            if (isnan(creal(points[i])))
                return UNUSUAL;
    int goes_on = next_goes_on(f);
    history->end++;
    if (kinpole_fit_frame(f, fitted, goes_on && !incoming->corrected) && !incoming->corrected) {
        history->end--;
        return UNUSUAL;
    }
    copy_frame(f, row, fitted);
    history->goes_on[row] = goes_on;
    memset(history->tilt_turn + row * bodies, 0, bodies * sizeof *history->tilt_turn);
    kinpole_unwrap(f);
    kinpole_follow_paths(f);
    if (incoming->tilts)
        follow_tilts(f, incoming->tilts + incoming->frame * bodies);
    for (long long b = 0; b < bodies; b++, points += width) {
        if (!isnan(history->angle[row * bodies + b]))
            note_seen(f, b, history->stamp[row]);
        else
            f->tracks.poses_held[b] += kinpole_is_held(f, b, points);
        for (long long k = 0; k < width; k++)
            f->tracks.markers_held[b] += kinpole_is_marker_held(f, b, points, k);
    }
    incoming->corrected = NULL;
    incoming->frame++;
    incoming->until_update--;
    return DONE;
}

/* Fills the arrays of `poses` by frame from the rows `oldest` to the newest, with positions of the
   points `hub` of `poses`. Returns whether any body tilts in the window. */
static int
fill_window(const Frames *f, long long oldest, Poses *poses)
{
    const HistoryColumns *history = &f->history;
    const BodyArrays *known = &f->known;
    int tilts = 0;
    for (long long i = oldest * known->bodies; i < history->end * known->bodies; i++)
        tilts |= history->tilt_turn[i] != 0.0;
    for (long long row = oldest; row < history->end; row++)
        for (long long b = 0; b < known->bodies; b++) {
            long long at = row * known->bodies + b, to = at - oldest * known->bodies;
            const double *information = history->information + 2 * row * known->bodies + b;
            double angle_information = information[0] * known->information_factor[b];
            double position_information =
                information[known->bodies] * known->information_factor[known->bodies + b];
            double growth = 0.0;
            Number hub = poses->hub[b], position = history->position[at];
            poses->heading[to] = history->angle[at];
            poses->angle[to] =
                history->angle[at] +
                (tilts ? history->tilt_turn[at] - known->learned_tilt_turn[b] : 0.0);
            if (hub != 0.0) {
                position += hub * unit_at(poses->angle[to]);
                /* The variance at the hub is that at the middle of the markers, plus that of the
                   angle times the squared distance. With hidden markers the fit is about another
                   middle, so the first may come out negative. */
                if (position_information > 0.0) {
                    double ratio = position_information / angle_information;
                    growth = 1.0 - square_of(known->middle[b]) * ratio;
                    growth = (growth > 0.0 ? growth : 0.0) +
                        square_of(hub - known->middle[b]) * ratio;
                }
            }
            poses->position[to] = position;
            poses->angle_information[to] = angle_information;
            poses->position_information[to] =
                growth > 0.0 ? position_information / growth : position_information;
        }
    return tilts;
}

/* The weighted mean of the markers of body `b` used in a row, m, in its frame; NaN without any. */
static Number
middle_of_used(const Frames *f, long long row, long long b)
{
    const BodyArrays *known = &f->known;
    Number sum = 0.0;
    double total = 0.0;
    for (long long k = 0; k < known->width; k++)
        if (f->history.used[(row * known->bodies + b) * known->width + k]) {
            double weight = known->weights[b * known->width + k];
            sum += weight * known->shape[b * known->width + k], total += weight;
        }
    return total > 0.0 ? sum / total : NAN;
}

/* Copies the derivatives of `call`, of one instant, except `reference`, into the results after
   those filled; NaN for a body whose `reason` there is above NOT_FULL. */
static void
copy_derivatives(const Call *call, Results *r)
{
    const DerivativeArrays *from = &call->derivatives, *to = &r->derivatives;
    long long orders = call->orders, bodies = call->bodies, all = r->instants * bodies;
    for (long long b = 0; b < bodies; b++) {
        long long at = r->filled * bodies + b;
        int is_known = r->reason[at] <= NOT_FULL;
        for (long long k = 0; k < orders; k++) {
            to->position[k * all + at] = is_known ? from->position[k * bodies + b] : NAN + I * NAN;
            to->angle[k * all + at] = is_known ? from->angle[k * bodies + b] : NAN;
        }
        for (long long k = 0; k < orders * orders; k++) {
            long long square = k * bodies + b;
            to->position_covariance[k * all + at] =
                is_known ? from->position_covariance[square] : NAN;
            to->angle_covariance[k * all + at] = is_known ? from->angle_covariance[square] : NAN;
        }
        to->span[at] = is_known ? from->span[b] : NAN;
        to->parameters[at] = is_known ? from->parameters[b] : NAN;
    }
}

/* Replaces the derived angles of order 0 (B), rad, by those of the headings, for bodies that tilt,
   and turns the hubs of `poses` into their axes. Returns the same as `kinpole_derive`. */
static int
derive_headings(Call *call, Poses *poses)
{
    DerivativeArrays derived = call->derivatives;
    if (kinpole_lay_out_derivatives(call, OF_HEADINGS, call->bodies, &call->derivatives))
        return NO_MEMORY;
    call->angle = poses->heading;
    int code = kinpole_derive(call);
    const double *heading = call->derivatives.angle;
    for (long long b = 0; b < call->bodies && !code; b++) {
        if (!isnan(derived.angle[b]))
            poses->hub[b] *= unit_at(derived.angle[b]);
        if (!isnan(heading[b]))
            poses->hub[b] *= conj(unit_at(heading[b]));
        derived.angle[b] = heading[b];
    }
    call->derivatives = derived;
    return code;
}

/* Passes the poses of a window to `call`: that of the rows from `oldest` on, with the result at row
   `now`. */
static void
pass_window(const Frames *f, long long oldest, long long now, Poses *poses, Call *call)
{
    poses->windows[0] = now - oldest;
    poses->windows[1] = 0;
    poses->windows[2] = f->history.end - 1 - oldest;
    call->frames = f->history.end - oldest;
    call->bodies = f->known.bodies;
    call->time = f->history.time + oldest;
    call->turns = f->history.turns + oldest * call->bodies;
    call->windows = poses->windows;
    call->left_out = f->tracks.left_out;
    call->angle = poses->angle;
    call->position = poses->position;
    call->angle_information = poses->angle_information;
    call->position_information = poses->position_information;
    call->noise = f->known.fit_noise;
    call->spectrum = f->known.spectrum;
}

/* Writes what the next result says of a body besides its derivatives, which are in `call`: that of
   the frame in row `now`, with the `reference` that `derivatives` describe. Returns whether it is
   a deformed body with a result. */
static int
write_body(const Frames *f, const Call *call, long long now, long long b, Number reference,
           Results *r)
{
    const HistoryColumns *history = &f->history;
    const BodyArrays *known = &f->known;
    long long bodies = known->bodies, at = now * bodies + b, to = r->filled * bodies + b;
    const double *information = history->information + 2 * now * bodies + b;
    int missing = kinpole_reason(f, now, b), seen = missing < NOT_SEEN;
    Number velocity = call->derivatives.position[bodies + b];
    int found = isfinite(call->derivatives.angle[bodies + b]) && isfinite(creal(velocity)) &&
        isfinite(cimag(velocity));
    r->reason[to] = missing ? missing : found ? KNOWN : NOT_FULL;
    r->size[to] = known->size[b];
    r->height[to] = history->height[at];
    r->derivatives.reference[to] = reference;
    r->frame_angle[to] = history->angle[at] + TURN * history->turns[at];
    r->frame_position[to] = history->position[at];
    r->noise[to] = known->fit_noise[b];
    r->middle[to] = isnan(known->angle_noise[b]) ? middle_of_used(f, now, b) : known->middle[b];
    for (int c = 0; c < 2; c++)
        r->information[(2 * r->filled + c) * bodies + b] =
            seen ? information[c * bodies] * known->information_factor[c * bodies + b] : 0.0;
    return r->reason[to] == KNOWN && known->freedom[b] > 0.0;
}

/* Computes the result of the frame in row `now` from the window of those from `oldest` on, and adds
   it to the results. `poses` has memory for the window. Sets the poses and the window of `call`.
   Returns the same as `kinpole_derive`; the results are as before if that is not DONE. */
static int
compute_result(const Frames *f, Call *call, Results *r, Poses *poses, long long oldest,
               long long now)
{
    const BodyArrays *known = &f->known;
    long long bodies = known->bodies, t = r->filled, deforms = 0;
    for (long long b = 0; b < bodies; b++) {
        long long to = t * bodies + b;
        int pinned = kinpole_holds_on_pin(f, oldest, b);
        r->pin[to] = pinned ? known->pin[b] : NAN + I * NAN;
        r->pin_variance[to] = pinned ? known->pin_variance[b] : NAN;
        poses->hub[b] = pinned ? 0.0 : known->reference[b];
    }
    int tilts = fill_window(f, oldest, poses);
    pass_window(f, oldest, now, poses, call);
    if (kinpole_lay_out_derivatives(call, OF_DERIVATIVES, bodies, &call->derivatives))
        return NO_MEMORY;
    int code = kinpole_derive(call);
    if (code)
        return code;
    for (long long b = 0; b < bodies; b++)
        if (!isnan(creal(call->derivatives.reference[b])))
            poses->hub[b] += call->derivatives.reference[b];
    if (tilts && (code = derive_headings(call, poses)))
        return code;
    for (long long b = 0; b < bodies; b++)
        deforms |= write_body(f, call, now, b, poses->hub[b], r);
    copy_derivatives(call, r);
    memcpy(r->shape + t * bodies * known->width, known->places,
           bodies * known->width * sizeof *r->shape);
    r->stamp[t] = f->history.stamp[now];
    r->due[t] = f->incoming.frame - 1;
    for (int k = 0; k < 3; k++)
        r->rows[3 * t + k] = poses->windows[k] + oldest - f->history.first;
    r->filled++;
    r->deformed += deforms;
    return DONE;
}

/* Writes `window_frames` and `interval` of the window up to the newest frame. Returns its first
   row. */
static long long
measure_window(Frames *f)
{
    HistoryColumns *history = &f->history;
    long long newest = history->end - 1, oldest;
    oldest = history->first + number_before(f, history->time[newest] - f->limits.window_ns);
    history->window_frames = newest - oldest + 1;
    history->interval = (double)(history->time[newest] - history->time[oldest]) /
        (history->window_frames > 1 ? history->window_frames - 1 : 1);
    return oldest;
}

/* Computes the results of the rows before `end`, from `first` on, that have none, from the window
   up to the newest frame, and moves `next_result` behind them. If results are to be complete, they
   wait for a window of enough frames. Returns DONE, or an error below 0. */
static int
compute_before(Frames *f, Call *call, Results *r, long long end)
{
    HistoryColumns *history = &f->history;
    const BodyArrays *known = &f->known;
    long long newest = history->end - 1, oldest = measure_window(f);
    int is_enough = newest - oldest >= r->fewest - 1;
    if (f->limits.complete && !is_enough)
        return DONE;
    if (history->next_result < end && r->instants && is_enough) {
        if (history->first + history->next_result < oldest)
            history->next_result = oldest - history->first;
        long long all = (history->end - oldest) * known->bodies;
        Poses poses;
        char *data = kinpole_buffer(
            call, OF_POSES, (all + known->bodies) * sizeof(Number) + 4 * all * sizeof(double));
        if (!data)
            return NO_MEMORY;
        TAKE(poses.position, all), TAKE(poses.hub, known->bodies), TAKE(poses.angle, all);
        TAKE(poses.heading, all), TAKE(poses.angle_information, all);
        TAKE(poses.position_information, all);
        for (; history->next_result < end; history->next_result++) {
            long long now = history->first + history->next_result;
            int code = r->filled == r->instants
                ? NO_ROOM : compute_result(f, call, r, &poses, oldest, now);
            if (code)
                return code;
        }
    }
    history->next_result = end > history->next_result ? end : history->next_result;
    return DONE;
}

/* Computes the results that are due with the newest frame. A frame is due once it is as old as the
   lag. If results are to be complete, the first ones are due once the window is full, and those of
   frames that the window has left behind, or that fell due in a gap, are from the one before.
   Returns DONE, or an error below 0. */
static int
compute_due(Frames *f, Call *call, Results *r)
{
    HistoryColumns *history = &f->history;
    if (history->end == history->first)
        return DONE;
    long long newest = history->time[history->end - 1];
    long long behind = measure_window(f) - history->first;
    if (f->limits.complete) {
        long long in_gap = number_before(f, newest - (long long)rint(f->limits.lag_ns));
        if (!history->goes_on[history->end - 1] && in_gap > behind)
            behind = in_gap;
        double length = (double)(newest - history->time[history->first]);
        if (!history->next_result &&
            length < (double)f->limits.window_ns - EARLY * history->interval)
            return DONE;
        if (history->next_result < behind) {
            history->end--;
            int code = compute_before(f, call, r, behind);
            history->end++;
            if (code)
                return code;
            measure_window(f);
        }
    }
    long long latest = newest - (long long)rint(f->limits.lag_ns - EARLY * history->interval);
    return compute_before(f, call, r, number_before(f, latest + 1));
}

int
kinpole_follow(Frames *f, Call *call, Results *r)
{
    const NewFrames *incoming = &f->incoming;
    for (;;) {
        int code = compute_due(f, call, r);
        if (code || incoming->frame == incoming->frames || incoming->until_update <= 0)
            return code;
        code = take_frame(f);
        if (code)
            return code;
    }
}
