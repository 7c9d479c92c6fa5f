/* Which rays may meet which shapes from a box of poses, and what they read of them: circles, then edges. */
#include <stdlib.h>

#include "scan.h"

#define PI 3.14159265358979323846
#define BEARING_ROUNDING 1e-9 /* radians by which the bearing of a ray or of a shape may be rounded */
#define STEEPEST 32.0         /* largest slope of the forms of circles, so that no rounding is amplified */
#define GRAZING 1.55          /* angle to the normal from which on an edge is bounded by its ends alone */

typedef struct {
    double x, y;
} Point;

/* The box, as rays need it: reach and turn are how far places and headings are from the middle at most. */
typedef struct {
    Point place, heading; /* heading: a unit vector */
    double theta, rx, ry, turn, reach, slack;
} Box;

/* A point in the frame of a ray: `along` it and to its `left`. */
static Point framed(Point ray, Point p) {
    return (Point){ray.x * p.x + ray.y * p.y, ray.x * p.y - ray.y * p.x};
}

static double spread_of(const Fan *fan, const Box *box, Point direction) {
    return fan->leeway->sideways * (fabs(direction.x) * box->rx + fabs(direction.y) * box->ry);
}

/* What the linear form of a point at a distance leaves out in the frame of a ray. */
static double turning_error(const Fan *fan, const Box *box, double distance) {
    return fan->leeway->turning * (0.5 * distance * box->turn * box->turn + box->reach * box->turn);
}

/* Half the angle that a disc fills when seen from a distance; pi from within. */
static double half_angle(const Fan *fan, double radius, double distance) {
    return fan->leeway->bearings * (distance > radius ? asin(least(radius / distance, 1.0)) : PI);
}

static Glimpse *next_glimpse(Glimpses *seen) {
    if (seen->count == seen->room) {
        const integer room = seen->room ? 2 * seen->room : 256;
        Glimpse *grown = realloc(seen->glimpse, (size_t)room * sizeof(Glimpse));
        if (!grown) return NULL;
        seen->glimpse = grown, seen->room = room;
    }
    return seen->glimpse + seen->count++;
}

/* The first ray whose bearing is at least, or more than, an angle. */
static integer first_from(const Fan *fan, double angle, int beyond) {
    integer low = 0, high = fan->rays;
    while (low < high) {
        const integer middle = (low + high) / 2;
        if (fan->bearing[middle] < angle || (beyond && fan->bearing[middle] == angle)) low = middle + 1;
        else high = middle;
    }
    return low;
}

/* The rays between two bearings: from `begin` to `end`, and those from the first to `again`, beyond a full turn. */
typedef struct {
    integer begin, end, again;
} Between;

static Between rays_between(const Fan *fan, double low, double high) {
    const int known = low <= high; /* every ray may meet what lies in no known direction */
    low = (known ? low : -PI) - BEARING_ROUNDING, high = (known ? high : PI) + BEARING_ROUNDING;
    const double turns = 2.0 * PI * floor((low + PI) / (2.0 * PI)); /* brings low into [-pi, pi) */
    low -= turns, high -= turns;
    Between found = {first_from(fan, low, 0), first_from(fan, high, 1) - 1, first_from(fan, high - 2.0 * PI, 1) - 1};
    if (found.again > found.begin - 1) found.again = found.begin - 1;
    return found;
}

static Point along_ray(const Fan *fan, const Box *box, integer ray) {
    const Point own = {fan->direction[2 * ray], fan->direction[2 * ray + 1]}, to = box->heading;
    return (Point){own.x * to.x - own.y * to.y, own.x * to.y + own.y * to.x};
}

/* `h(b) = sqrt(r^2 - b^2)` lies between two lines of one slope wherever the circle is met. */
static double lines_of_height(double b, double spread, double radius, double *tangent, double *chord) {
    const double ends[2] = {most(least(b - spread, radius), -radius), most(least(b + spread, radius), -radius)};
    double heights[2];
    for (int k = 0; k < 2; k++) heights[k] = sqrt((radius - fabs(ends[k])) * (radius + fabs(ends[k])));
    const double total = heights[0] + heights[1];
    double s = total > 0.0 ? -(ends[0] + ends[1]) / total : 0.0;
    s = most(least(s, STEEPEST), -STEEPEST);
    *tangent = radius * sqrt(1.0 + s * s);
    *chord = least(heights[0] - s * ends[0], heights[1] - s * ends[1]);
    return s;
}

static int meet_circle(const Fan *fan, const Box *box, integer ray, Point away, double far, double radius, int passed,
                       Glimpses *seen) {
    const double slack = box->slack;
    const Point u = along_ray(fan, box, ray), w = framed(u, away);
    const double a = w.x, b = w.y, error = turning_error(fan, box, far);
    const double b_spread = spread_of(fan, box, (Point){-u.y, u.x}) + fabs(a) * box->turn + error + slack;
    const double a_spread = spread_of(fan, box, u) + fabs(b) * box->turn + error + slack;
    const int missed = fabs(b) - b_spread > radius || a + a_spread < 0.0;
    double tangent, chord;
    const double s = lines_of_height(b, b_spread, radius, &tangent, &chord);
    tangent = radius + fan->leeway->tangent * (tangent - radius), chord = tangent - fan->leeway->chord * (tangent - chord);
    const double value = a - s * b, rest = sqrt(1.0 + s * s) * (error + slack);
    const double depth = sqrt(most(radius * radius - b * b, 0.0));
    Glimpse *found = next_glimpse(seen);
    if (!found) return 0;
    *found = (Glimpse){
        .bin = ray / fan->each,
        .nearest = fabs(b) <= radius && a > 0.0 ? a - depth : INFINITY,
        .slope = {-(u.x + s * u.y) * box->rx, (s * u.x - u.y) * box->ry, (b + s * a) * box->turn},
        .lower = missed ? INFINITY : value - tangent - rest,
        .upper = value - chord + rest,
        .least = missed ? INFINITY : most(far - radius - box->reach, 0.0) - slack,
        .most = far + box->reach + slack,
        .certain = fabs(b) + b_spread < radius && a > a_spread && !passed,
    };
    return 1;
}

static int see_circle(const Fan *fan, const Box *box, integer k, Glimpses *seen) {
    const Point away = {fan->centre[2 * k] - box->place.x, fan->centre[2 * k + 1] - box->place.y};
    const double radius = fan->radius[k], far = hypot(away.x, away.y), grown = radius + box->reach + box->slack;
    if (far - grown >= fan->maximum) return 1;
    const double bearing = atan2(away.y, away.x) - box->theta;
    const double half = half_angle(fan, grown, far) + box->turn + box->slack;
    const Between some = rays_between(fan, bearing - half, bearing + half);
    for (integer at = some.begin; at <= some.end; at++)
        if (!meet_circle(fan, box, fan->order[at], away, far, radius, fan->circle_passed[k], seen)) return 0;
    for (integer at = 0; at <= some.again; at++)
        if (!meet_circle(fan, box, fan->order[at], away, far, radius, fan->circle_passed[k], seen)) return 0;
    return 1;
}

/* An edge from the middle pose: its ends, its unit normal away from the robot, the distance of its line. */
typedef struct {
    Point first, second, normal;
    double distance, spread, far_first, far_second;
    int passed;
} Edge;

/* How far `(d - n.D) sec` falls below and rises above its linear form, for angles whose cosine is at least that. */
static void rest_of_secant(const Fan *fan, const Box *box, const Edge *edge, double cosine, double *below, double *above) {
    const double steep = 1.0 / cosine, squared = steep * steep;
    const double first_order = steep * sqrt(most(squared - 1.0, 0.0));
    const double second_order = fan->leeway->curvature * 0.5 * box->turn * box->turn * steep * (2.0 * squared - 1.0);
    const double mixed = fan->leeway->mixed * edge->spread * box->turn * first_order + box->slack * squared;
    *below = mixed + most(-edge->distance, 0.0) * second_order;
    *above = mixed + most(edge->distance, 0.0) * second_order;
}

static int meet_edge(const Fan *fan, const Box *box, integer ray, const Edge *edge, Glimpses *seen) {
    const double slack = box->slack, d = edge->distance;
    const Point u = along_ray(fan, box, ray), w[2] = {framed(u, edge->first), framed(u, edge->second)};
    const double sideways = spread_of(fan, box, (Point){-u.y, u.x}) + slack, forward = spread_of(fan, box, u) + slack;
    const double far[2] = {edge->far_first, edge->far_second};
    double left[2], right[2], nearer[2], farther[2];
    for (int k = 0; k < 2; k++) {
        const double error = turning_error(fan, box, far[k]);
        const double b_spread = sideways + fabs(w[k].x) * box->turn + error;
        const double a_spread = forward + fabs(w[k].y) * box->turn + error;
        left[k] = w[k].y + b_spread, right[k] = w[k].y - b_spread;
        nearer[k] = w[k].x - a_spread, farther[k] = w[k].x + a_spread;
    }
    const double farthest = most(farther[0], farther[1]);
    const int missed = right[0] > 0.0 || left[1] < 0.0 || farthest < 0.0, crossed = left[0] < 0.0 && right[1] > 0.0;
    const Point aim = framed(u, edge->normal); /* cosine and sine of the angle from the ray to the normal */
    const double phi = fabs(atan2(aim.y, aim.x)) + box->turn;
    const int oblique = phi < GRAZING;
    const double secant = 1.0 / (oblique ? aim.x : 1.0), tangent = (oblique ? aim.y : 0.0) * secant, t = d * secant;
    double below, above;
    rest_of_secant(fan, box, edge, oblique ? cos(phi) : 1.0, &below, &above);
    Glimpse *found = next_glimpse(seen);
    if (!found) return 0;
    *found = (Glimpse){
        .bin = ray / fan->each,
        .nearest = oblique && w[0].y <= 0.0 && w[1].y >= 0.0 && d > 0.0 ? t : INFINITY,
        .lower = missed ? INFINITY : oblique ? t - below : -INFINITY,
        .upper = oblique ? t + above : INFINITY,
        .least = missed ? INFINITY : most(least(nearer[0], nearer[1]), 0.0) - slack,
        .most = farthest + slack,
        .certain = crossed && d > edge->spread + slack && !edge->passed,
    };
    if (oblique) {
        found->slope[0] = -secant * edge->normal.x * box->rx;
        found->slope[1] = -secant * edge->normal.y * box->ry;
        found->slope[2] = -t * tangent * box->turn;
    }
    return 1;
}

/* The bearings between which every ray lies that meets an edge from some pose. */
static Between rays_of_edge(const Fan *fan, const Box *box, const Edge *edge) {
    const double reach = box->reach + box->slack, turn = box->turn + box->slack;
    if (edge->distance <= reach || least(edge->far_first, edge->far_second) <= reach) {
        const Point a = edge->first, b = edge->second, middle = {0.5 * (a.x + b.x), 0.5 * (a.y + b.y)};
        const double disc = 0.5 * hypot(b.x - a.x, b.y - a.y) + reach;
        const double around = half_angle(fan, disc, hypot(middle.x, middle.y)) + turn;
        const double towards = atan2(middle.y, middle.x) - box->theta;
        return rays_between(fan, towards - around, towards + around);
    }
    const Point a = edge->first, b = edge->second;
    const double begin = atan2(a.y, a.x) - box->theta;
    const double angle = atan2(a.x * b.y - a.y * b.x, a.x * b.x + a.y * b.y);
    const double before = half_angle(fan, reach, edge->far_first), after = half_angle(fan, reach, edge->far_second);
    return rays_between(fan, begin - before - turn, begin + angle + after + turn);
}

static int see_edge(const Fan *fan, const Box *box, integer m, Glimpses *seen) {
    const Point p = {fan->first[2 * m], fan->first[2 * m + 1]}, q = {fan->second[2 * m], fan->second[2 * m + 1]};
    const double length = hypot(q.x - p.x, q.y - p.y);
    Edge edge = {
        .first = {p.x - box->place.x, p.y - box->place.y},
        .second = {q.x - box->place.x, q.y - box->place.y},
        .normal = {(q.y - p.y) / length, (p.x - q.x) / length},
        .passed = fan->edge_passed[m],
    };
    edge.distance = edge.normal.x * edge.first.x + edge.normal.y * edge.first.y;
    edge.spread = fabs(edge.normal.x) * box->rx + fabs(edge.normal.y) * box->ry;
    if (edge.distance - edge.spread >= fan->maximum + box->slack || edge.distance + edge.spread <= -box->slack) return 1;
    edge.far_first = hypot(edge.first.x, edge.first.y), edge.far_second = hypot(edge.second.x, edge.second.y);
    const Between some = rays_of_edge(fan, box, &edge);
    for (integer at = some.begin; at <= some.end; at++)
        if (!meet_edge(fan, box, fan->order[at], &edge, seen)) return 0;
    for (integer at = 0; at <= some.again; at++)
        if (!meet_edge(fan, box, fan->order[at], &edge, seen)) return 0;
    return 1;
}

int look(const Fan *fan, const double *centre, const double *radius, double slack, Glimpses *seen) {
    const Box box = {
        {centre[0], centre[1]}, {cos(centre[2]), sin(centre[2])}, centre[2], radius[0], radius[1], radius[2],
        hypot(radius[0], radius[1]), slack,
    };
    seen->count = 0;
    for (integer k = 0; k < fan->circles; k++)
        if (!see_circle(fan, &box, k, seen)) return 0;
    for (integer m = 0; m < fan->edges; m++)
        if (!see_edge(fan, &box, m, seen)) return 0;
    for (integer t = 0; t < seen->count; t++) {
        const Glimpse *one = seen->glimpse + t;
        const double *s = one->slope;
        if (isnan(s[0] + s[1] + s[2]) || isnan(one->lower) || isnan(one->upper) || isnan(one->least) || isnan(one->most))
            return 0;
    }
    return 1;
}
