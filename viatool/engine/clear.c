/* Whether a disc keeps its clearance for every command of a box over the whole path, cutting what stays undecided. */
#include <fenv.h>
#include <stdlib.h>
#include <string.h>

#include "clear.h"

#define EXPORTED __attribute__((visibility("default")))

enum { MOST_AXES = 3, POSE = 3, MOST_SIDES = MOST_AXES + 1 + POSE };

typedef struct {
    double x, y;
} Point;

/* The shapes of one scene that are near enough to count, and whether the state begins in an obstacle or off the map. */
typedef struct {
    integer circles, edges, walls;
    const double **circle, **edge, **wall; /* walls of a convex arena by their normals */
    int within;
} Near;

/* A box of commands, fractions of the path and offsets of the pose, as `MotionBoxes`. */
typedef struct {
    double lower[MOST_SIDES], upper[MOST_SIDES], shares[MOST_SIDES];
} Piece;

typedef struct {
    double ahead, left, turn;
} Velocity;

static double point_edge_squared(Point p, Point first, Point second) {
    const double ex = second.x - first.x, ey = second.y - first.y, ax = p.x - first.x, ay = p.y - first.y;
    const double square = ex * ex + ey * ey;
    double along = (ex * ax + ey * ay) / (square > 0.0 ? square : 1.0);
    along = along < 0.0 ? 0.0 : along > 1.0 ? 1.0 : along; /* what is not a number stays so */
    const double rx = ax - along * ex, ry = ay - along * ey;
    return rx * rx + ry * ry;
}

static double cross(Point a, Point b) { return a.x * b.y - a.y * b.x; }
static Point between(Point from, Point to) { return (Point){to.x - from.x, to.y - from.y}; }

/* The least of two distances; what is not a number stays so. */
static double nearer(double a, double b) { return isnan(a) || a < b ? a : b; }

static double segment_edge(Point start, Point end, Point first, Point second) {
    const Point edge = between(first, second), way = between(start, end);
    if (cross(edge, between(first, start)) * cross(edge, between(first, end)) < 0.0 &&
        cross(way, between(start, first)) * cross(way, between(start, second)) < 0.0)
        return 0.0;
    double square = point_edge_squared(start, first, second);
    square = nearer(square, point_edge_squared(end, first, second));
    square = nearer(square, point_edge_squared(first, start, end));
    return sqrt(nearer(square, point_edge_squared(second, start, end)));
}

/* How often rings run counter-clockwise around a point. */
static integer winding(const double *ring, integer edges, Point p) {
    integer number = 0;
    for (integer m = 0; m < edges; m++) {
        const Point first = {ring[4 * m], ring[4 * m + 1]}, second = {ring[4 * m + 2], ring[4 * m + 3]};
        const double left = cross(between(first, second), between(first, p));
        const int below = first.y <= p.y, second_below = second.y <= p.y;
        number += (below && !second_below && left > 0.0) - (!below && second_below && left < 0.0);
    }
    return number;
}

static int is_within(const Around *around, integer scene, Point p) {
    return winding(around->edge + 4 * scene * around->edges, around->edges, p) > 0 ||
           (!around->convex && winding(around->wall, around->walls, p) == 0);
}

static double clearance_of(const Near *near, int convex, Point start, Point end) {
    double nearest = near->within ? 0.0 : INFINITY;
    for (integer k = 0; k < near->circles; k++) {
        const double *at = near->circle[k];
        nearest = nearer(nearest, sqrt(point_edge_squared((Point){at[0], at[1]}, start, end)) - at[2]);
    }
    for (integer m = 0; m < near->edges; m++) {
        const double *at = near->edge[m];
        nearest = nearer(nearest, segment_edge(start, end, (Point){at[0], at[1]}, (Point){at[2], at[3]}));
    }
    for (integer n = 0; n < near->walls; n++) {
        const double *at = near->wall[n];
        if (convex) {
            nearest = nearer(nearest, at[2] - (at[0] * start.x + at[1] * start.y));
            nearest = nearer(nearest, at[2] - (at[0] * end.x + at[1] * end.y));
        } else
            nearest = nearer(nearest, segment_edge(start, end, (Point){at[0], at[1]}, (Point){at[2], at[3]}));
    }
    return nearest < 0.0 ? 0.0 : nearest;
}

/* Keeps the shapes that are not farther from a place than a limit. */
static void gather(const Around *around, integer scene, Point p, double limit, Near *near) {
    near->circles = near->edges = near->walls = 0;
    near->within = is_within(around, scene, p);
    for (integer k = 0; k < around->circles; k++) {
        const double *at = around->circle + 3 * (scene * around->circles + k);
        if (!(hypot(at[0] - p.x, at[1] - p.y) - at[2] > limit)) near->circle[near->circles++] = at;
    }
    for (integer m = 0; m < around->edges; m++) {
        const double *at = around->edge + 4 * (scene * around->edges + m);
        const double away = sqrt(point_edge_squared(p, (Point){at[0], at[1]}, (Point){at[2], at[3]}));
        if (!(away > limit)) near->edge[near->edges++] = at;
    }
    for (integer n = 0; n < around->walls; n++) {
        const double *ends = around->wall + 4 * n, *normal = around->normal + 3 * n;
        const double away = around->convex
                                ? normal[2] - (normal[0] * p.x + normal[1] * p.y)
                                : sqrt(point_edge_squared(p, (Point){ends[0], ends[1]}, (Point){ends[2], ends[3]}));
        if (!(away > limit)) near->wall[near->walls++] = around->convex ? normal : ends;
    }
}

static double speed_of(double ahead, double left) { return left == 0.0 ? fabs(ahead) : hypot(ahead, left); }

static double seconds_of(const Asked *asked, double speed, double turn) {
    if (asked->deceleration == 0.0) return asked->interval;
    return asked->interval + 0.5 * (speed + asked->rim * turn) / asked->deceleration;
}

static Velocity velocity_of(const Asked *asked, const double *command) {
    return (Velocity){asked->ahead < 0 ? 0.0 : command[asked->ahead], asked->left < 0 ? 0.0 : command[asked->left],
                      asked->turn < 0 ? 0.0 : command[asked->turn]};
}

/* Where a velocity leads in a time, along an arc; see viatool/motion/arcs.py. */
static Point drive(const double *pose, Velocity u, double seconds) {
    const double half = 0.5 * u.turn * seconds, heading = pose[2] + half;
    const double share = seconds * (fabs(half) < 1e-4 ? 1.0 - half * half / 6.0 : sin(half) / half);
    const double cosine = cos(heading), sine = sin(heading);
    return (Point){pose[0] + share * (u.ahead * cosine - u.left * sine),
                   pose[1] + share * (u.ahead * sine + u.left * cosine)};
}

static double larger(double a, double b) { return fabs(a) > fabs(b) ? fabs(a) : fabs(b); }
static double smaller(double a, double b) { return a * b > 0.0 ? least(fabs(a), fabs(b)) : 0.0; }

/* Each part of a path, signed, that goes with the sizes of the other parts. */
static Velocity path_of(const Asked *asked, Velocity part, Velocity others) {
    const double turning = fabs(others.turn);
    return (Velocity){part.ahead * seconds_of(asked, speed_of(part.ahead, others.left), turning),
                      part.left * seconds_of(asked, speed_of(others.ahead, part.left), turning),
                      part.turn * seconds_of(asked, speed_of(others.ahead, others.left), fabs(part.turn))};
}

static void widen_path(const Asked *asked, Velocity end, Velocity others, Velocity middle, Velocity *radii) {
    const Velocity at = path_of(asked, end, others);
    radii->ahead = most(radii->ahead, fabs(at.ahead - middle.ahead));
    radii->left = most(radii->left, fabs(at.left - middle.left));
    radii->turn = most(radii->turn, fabs(at.turn - middle.turn));
}

/* By how much the parts of a path differ from those of the centre, see `path_radii` in viatool/motion/twists.py. */
static Velocity radii_of(const Asked *asked, Velocity lower, Velocity upper, Velocity centre) {
    const Velocity middle = path_of(asked, centre, centre);
    const Velocity large = {larger(lower.ahead, upper.ahead), larger(lower.left, upper.left),
                            larger(lower.turn, upper.turn)};
    const Velocity small = {smaller(lower.ahead, upper.ahead), smaller(lower.left, upper.left),
                            smaller(lower.turn, upper.turn)};
    Velocity radii = {0.0, 0.0, 0.0};
    widen_path(asked, lower, small, middle, &radii), widen_path(asked, upper, small, middle, &radii);
    widen_path(asked, lower, large, middle, &radii), widen_path(asked, upper, large, middle, &radii);
    return radii;
}

/* The longest path of a box of commands, in metres. */
static double longest_of(const Asked *asked, const double *lower, const double *upper) {
    const Velocity low = velocity_of(asked, lower), high = velocity_of(asked, upper);
    const double speed = speed_of(larger(low.ahead, high.ahead), larger(low.left, high.left));
    return speed * seconds_of(asked, speed, larger(low.turn, high.turn));
}

static double rounding_of(const Asked *asked, const double *pose, double way, double turn) {
    const double place = fabs(pose[0]) + fabs(pose[1]) + fabs(pose[2]);
    return asked->rounding * (asked->scale + place + way + turn + asked->radius);
}

/* Bounds the clearance over a piece from below, and what its centre attains from above; writes its shares. */
static void enclose(const Asked *asked, const Near *near, const double *pose, int boxed, Piece *piece,
                    double *least_left, double *attained) {
    const integer axes = asked->axes, fraction = axes, offset = axes + 1;
    const Deviations *of = asked->deviations;
    double command[MOST_AXES], radius[POSE] = {0.0, 0.0, 0.0}, from[POSE] = {pose[0], pose[1], pose[2]};
    for (integer a = 0; a < axes; a++) command[a] = 0.5 * (piece->lower[a] + piece->upper[a]);
    for (integer i = 0; boxed && i < POSE; i++) {
        from[i] += 0.5 * (piece->lower[offset + i] + piece->upper[offset + i]);
        radius[i] = 0.5 * (piece->upper[offset + i] - piece->lower[offset + i]);
    }
    const double start = piece->lower[fraction], end = piece->upper[fraction];
    const Velocity u = velocity_of(asked, command);
    const double speed = speed_of(u.ahead, u.left), turn = fabs(u.turn), seconds = seconds_of(asked, speed, turn);
    const double length = speed * seconds, span = seconds * (end - start);
    const double sagitta = 0.125 * speed * turn * span * span;
    const double rounding =
        rounding_of(asked, from, longest_of(asked, piece->lower, piece->upper), turn * seconds);
    const double left = clearance_of(near, (int)asked->around.convex, drive(from, u, seconds * start),
                                     drive(from, u, seconds * end)) - asked->radius;
    const Velocity radii =
        radii_of(asked, velocity_of(asked, piece->lower), velocity_of(asked, piece->upper), u);
    const double heading = end * of->turns * radii.turn;
    const double aside = of->sideways * 0.5 * end * length * heading;
    const double away = end * of->speeds * speed_of(radii.ahead, radii.left) + aside;
    const double elsewhere = of->places * hypot(radius[0], radius[1]), turned = end * length * radius[2];
    for (integer a = 0; a < axes; a++)
        piece->shares[a] = end * (a == asked->turn ? 0.5 * end * length : 1.0) * 0.5 *
                           (piece->upper[a] - piece->lower[a]) * seconds;
    piece->shares[fraction] = sagitta;
    if (boxed) {
        const double shares[POSE] = {radius[0], radius[1], turned};
        memcpy(piece->shares + offset, shares, sizeof shares);
    }
    *attained = left + sagitta + rounding;
    *least_left = left - away - elsewhere - of->headings * turned - of->sagitta * sagitta - rounding;
}

static void halve(const Piece *piece, integer sides, Piece *first, Piece *second) {
    integer axis = 0;
    for (integer d = 1; d < sides; d++)
        if (piece->shares[d] > piece->shares[axis]) axis = d;
    const double middle = 0.5 * (piece->lower[axis] + piece->upper[axis]);
    const Piece whole = *piece;
    *first = whole, *second = whole;
    first->upper[axis] = middle, second->lower[axis] = middle;
}

enum { UNDECIDED, PROVED, REFUTED };

/* Decides one state; its open pieces stand in one array, and their halves go to the other. */
static int decide(const Asked *asked, const Near *near, const double *pose, int boxed, Piece *open, Piece *halves) {
    const integer sides = asked->axes + 1 + (boxed ? POSE : 0);
    integer count = 1;
    for (integer level = 0; level <= asked->levels; level++) {
        integer kept = 0;
        int hopeless = 0;
        for (integer c = 0; c < count; c++) {
            double least_left, attained;
            enclose(asked, near, pose, boxed, open + c, &least_left, &attained);
            if (attained < asked->threshold) return REFUTED;
            if (least_left > asked->threshold) continue;
            double spread = 0.0;
            for (integer d = 0; d < sides; d++) spread += open[c].shares[d];
            hopeless |= !(spread >= asked->tolerance);
            if (kept < asked->cells) open[kept] = open[c];
            kept++;
        }
        if (!kept) return PROVED;
        if (kept > asked->cells || hopeless) return UNDECIDED;
        for (integer c = 0; c < kept; c++) halve(open + c, sides, halves + 2 * c, halves + 2 * c + 1);
        Piece *other = open;
        open = halves, halves = other, count = 2 * kept;
    }
    return UNDECIDED;
}

static int all_finite(const double *values, integer count) {
    for (integer i = 0; i < count; i++)
        if (!is_finite(values[i])) return 0;
    return 1;
}

static int begin_near(const Around *around, Near *near, const double ***memory) {
    const size_t count = (size_t)(around->circles + around->edges + around->walls);
    *memory = malloc((count ? count : 1) * sizeof(double *));
    near->circle = *memory, near->edge = near->circle + around->circles, near->wall = near->edge + around->edges;
    return *memory != NULL;
}

/* Decides states at poses (count, 3), or at boxes of them; `radius` is NULL for poses alone. */
EXPORTED int viatool_clear(const Asked *asked, integer count, const double *poses, const double *radius,
                           const integer *scene, const double *lower, const double *upper, uint8_t *proved,
                           uint8_t *refuted) {
    const integer axes = asked->axes;
    Near near;
    const double **memory = NULL;
    Piece *pieces = malloc((size_t)(4 * asked->cells + 2) * sizeof(Piece));
    const int ready = begin_near(&asked->around, &near, &memory) && pieces && fegetround() == FE_TONEAREST;
    for (integer b = 0; ready && b < count; b++) {
        const double *pose = poses + POSE * b, *low = lower + axes * b, *high = upper + axes * b;
        proved[b] = refuted[b] = 0;
        if (!all_finite(pose, POSE) || !all_finite(low, axes) || !all_finite(high, axes) ||
            (radius && !all_finite(radius + POSE * b, POSE)))
            continue;
        Piece *first = pieces;
        memcpy(first->lower, low, (size_t)axes * 8), memcpy(first->upper, high, (size_t)axes * 8);
        first->lower[axes] = 0.0, first->upper[axes] = 1.0;
        double extent = 0.0;
        if (radius) {
            const double *around = radius + POSE * b;
            for (integer i = 0; i < POSE; i++)
                first->lower[axes + 1 + i] = -around[i], first->upper[axes + 1 + i] = around[i];
            extent = hypot(around[0], around[1]);
        }
        const double way = longest_of(asked, low, high);
        const double reached = asked->threshold + asked->radius + extent + asked->deviations->way * way;
        const double limit = reached + 4.0 * rounding_of(asked, pose, way, extent);
        gather(&asked->around, scene[b], (Point){pose[0], pose[1]}, limit, &near);
        const int found = decide(asked, &near, pose, radius != NULL, pieces, pieces + 2 * asked->cells + 1);
        proved[b] = found == PROVED, refuted[b] = found == REFUTED;
    }
    free(pieces), free((void *)memory);
    return ready;
}

/* The distance from a place to what is near, at most 0 within it. */
static double distance_of(const Near *near, int convex, Point at) {
    double nearest = near->within ? 0.0 : INFINITY;
    for (integer k = 0; k < near->circles; k++) {
        const double x = near->circle[k][0] - at.x, y = near->circle[k][1] - at.y;
        nearest = nearer(nearest, sqrt(x * x + y * y) - near->circle[k][2]);
    }
    double square = INFINITY;
    for (integer m = 0; m < near->edges; m++) {
        const double *ends = near->edge[m];
        square = nearer(square, point_edge_squared(at, (Point){ends[0], ends[1]}, (Point){ends[2], ends[3]}));
    }
    for (integer n = 0; n < near->walls; n++) {
        const double *wall = near->wall[n];
        if (convex)
            nearest = nearer(nearest, wall[2] - (wall[0] * at.x + wall[1] * at.y));
        else
            square = nearer(square, point_edge_squared(at, (Point){wall[0], wall[1]}, (Point){wall[2], wall[3]}));
    }
    return nearer(nearest, sqrt(square));
}

/* The least distance at the ends of equal steps of one path, and at which of them first. */
static double nearest_on_path(const Asked *asked, integer scene, const double *pose, const double *command,
                              double now, integer steps, Near *near, integer *first) {
    const int convex = (int)asked->around.convex;
    const Velocity u = velocity_of(asked, command);
    const double speed = speed_of(u.ahead, u.left), seconds = seconds_of(asked, speed, fabs(u.turn)) / (double)steps;
    const double half = 0.5 * u.turn * seconds;
    const double share = seconds * (fabs(half) < 1e-4 ? 1.0 - half * half / 6.0 : sin(half) / half);
    const double turn_x = cos(2.0 * half), turn_y = sin(2.0 * half);
    double way_x = cos(pose[2] + half), way_y = sin(pose[2] + half), nearest = now;
    Point at = {pose[0], pose[1]};
    gather(&asked->around, scene, at, now + 2.0 * speed * seconds * (double)steps + 1e-6, near); /* others never are */
    *first = 0;
    for (integer step = 1; step <= steps; step++) {
        at.x += share * (u.ahead * way_x - u.left * way_y), at.y += share * (u.ahead * way_y + u.left * way_x);
        const double turned = way_x * turn_x - way_y * turn_y;
        way_y = way_x * turn_y + way_y * turn_x, way_x = turned;
        near->within = is_within(&asked->around, scene, at);
        const double away = distance_of(near, convex, at);
        if (away < nearest) nearest = away, *first = step;
    }
    return nearest;
}

/* The least clearance (count, each) at the ends of equal steps of the paths of commands (count, each, axes), and after
 * how many steps: nothing is proved by it. */
EXPORTED int viatool_nearest(const Asked *asked, integer count, integer each, const double *poses,
                             const integer *scene, const double *commands, integer steps, double *found,
                             integer *step) {
    Near near;
    const double **memory = NULL;
    const int ready = begin_near(&asked->around, &near, &memory);
    for (integer b = 0; ready && b < count; b++) {
        const double *pose = poses + POSE * b;
        gather(&asked->around, scene[b], (Point){pose[0], pose[1]}, INFINITY, &near);
        const double now = distance_of(&near, (int)asked->around.convex, (Point){pose[0], pose[1]});
        for (integer k = b * each; k < (b + 1) * each; k++) {
            const double *command = commands + k * asked->axes;
            const double left = nearest_on_path(asked, scene[b], pose, command, now, steps, &near, step + k);
            found[k] = left > asked->radius ? left - asked->radius : 0.0;
        }
    }
    free((void *)memory);
    return ready;
}
