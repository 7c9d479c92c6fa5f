/* How near a robot whose footprint is a disc comes to what stands around it, one state at a time.
 *
 * The derivation is that of viatool/safety/enclosure.py, whose numpy code is the reference; how rounding is covered
 * stands in docs/kernel.md, K13. Python packs what is around, and what is asked (viatool/safety/compiled.py).
 */
#ifndef VIATOOL_CLEAR_H
#define VIATOOL_CLEAR_H

#include "kernel.h"

/* Factors of what keeps a path from where its centre leads, 1 each; a test may leave one out. */
typedef struct {
    double speeds, turns, sideways, sagitta, places, headings, way;
} Deviations;

typedef struct {
    integer circles, edges, walls, convex; /* of each scene, and of the arena that all of them share */
    const double *circle;                  /* (scenes, circles, 3) x, y, radius */
    const double *edge;                    /* (scenes, edges, 4) both ends, the inside to the left */
    const double *wall;                    /* (walls, 4) both ends, the inside to the left */
    const double *normal;                  /* (walls, 3) of a convex arena: outward, and its offset */
} Around;

typedef struct {
    Around around;
    integer axes, ahead, left, turn; /* of a command: how many, and which axis is what; -1 for none */
    integer levels, cells;           /* how often boxes are halved, and how many may be open */
    double tolerance, threshold;
    double radius, scale;            /* of the footprint, and of the map, in metres */
    double interval, deceleration, rim; /* deceleration 0 without brakes */
    double rounding;                 /* metres for each metre of scale */
    const Deviations *deviations;
} Asked;

#endif
