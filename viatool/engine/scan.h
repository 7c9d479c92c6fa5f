/* What a LiDAR reads anywhere in boxes of poses, one box at a time.
 *
 * The derivation is that of viatool/sight/scan.py, whose numpy code is the reference; how rounding is covered stands in
 * docs/kernel.md, K10. Python packs what is around, and the rays, into a Fan (viatool/sight/compiled.py).
 */
#ifndef VIATOOL_SCAN_H
#define VIATOOL_SCAN_H

#include "kernel.h"

/* Factors of what a form leaves out, 1 each; a test may leave one out. */
typedef struct {
    double turning, sideways, tangent, chord, curvature, mixed, bearings, apart;
} Leeway;

typedef struct {
    integer circles, edges, rays, bins, each; /* each: rays of a bin */
    const double *centre, *radius;            /* of circles: x and y one after the other */
    const double *first, *second;             /* of edges, likewise; the visible side to their left */
    const uint8_t *circle_passed, *edge_passed; /* whether a ray may pass it without seeing it */
    const double *bearing;                    /* (rays,) ascending within [-pi, pi) */
    const integer *order;                     /* (rays,) which ray each of them is */
    const double *direction;                  /* (rays, 2) cosine and sine, in the robot's frame */
    double minimum, maximum;                  /* metres */
    const Leeway *leeway;
} Fan;

/* A ray that may meet a shape somewhere in a box; the fields are those of viatool/sight/glimpses.py. */
typedef struct {
    integer bin;
    double nearest, slope[3], lower, upper, least, most;
    int certain;
} Glimpse;

typedef struct {
    Glimpse *glimpse;
    integer count, room;
} Glimpses;

/* sight.c: tells whether there was memory, and whether every number was one */
int look(const Fan *fan, const double *centre, const double *radius, double slack, Glimpses *seen);

#endif
