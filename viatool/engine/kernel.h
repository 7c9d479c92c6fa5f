/* The compiled engine: one state at a time through a network, as Taylor models of order 1.
 *
 * What is computed, and why every rounding is covered, is derived in docs/kernel.md, section by section (K1, K2, ...).
 * Python packs a network into arrays of the structs below (viatool/taylor/packed.py); all fields have 8 bytes.
 */
#ifndef VIATOOL_KERNEL_H
#define VIATOOL_KERNEL_H

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>

#if FLT_EVAL_METHOD != 0
#error "every operation has to be rounded to double at once"
#endif

#if defined(VIATOOL_CLONES)
#define EVERY_PROCESSOR __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define EVERY_PROCESSOR
#endif

typedef int64_t integer;

enum { INPUT, AFFINE, ACTIVATION };
enum { EXACT, OF_THE_LARGEST, OF_THE_VALUE }; /* what a runtime's activation errs relative to */

typedef struct {
    integer kind, size, offset;    /* offset: where its neurons stand among those of all nodes */
    integer source, sources;       /* which of the sources it reads */
    integer bias, bias_size;       /* places in numbers, (size,) each */
    integer curve;                 /* which curve an activation has */
    integer elementwise;           /* of an affine node: each neuron reads one number */
    integer factor, flushed, floor; /* places of what the program's row errs by, and of its least values */
    integer error;                 /* EXACT, ... of an activation */
} Node;

typedef struct {
    integer node;
    integer weight, absolute, merged; /* places of matrices, a row for each neuron, padded to a multiple of 8 */
    integer weight_t, absolute_t, merged_t; /* and transposed, padded likewise */
} Source;

typedef struct {
    integer count, edges, kinds, lowest, highest; /* places: (count + 1,), (count,), (count, count) twice */
} Cells;

typedef struct {
    integer pieces;                                   /* of a curve of straight lines; 0 where it is bent */
    integer kinks, breaks, slopes, lowest, highest, rounded; /* of the lines: places, (pieces,) each */
    integer rising, bend, relu;                       /* never falls; convex 1, concave -1, else 0; the larger of x and 0 */
    integer grid, steps, tails;                       /* of a bent curve: places, see K5; steps to a unit */
    Cells values, derivative;                         /* where the curve and where its slope turn */
} Curve;

typedef struct {
    double gamma, backward;      /* relative errors of the engine's sums over what a node reads, and over its rows */
    double unit, tiny, largest;  /* of the program's precision */
    double error_units, amplitude;
} Figure;

typedef struct {
    double sums, lines, underflow, slopes, tilts, program, errors, back, core; /* 1 each; a test may leave one out */
} Allowances;

typedef struct {
    integer nodes, trunk, neurons; /* nodes of the trunk come first; neurons of all nodes together */
    const Node *node;
    const Source *source;
    const Curve *curve;
    const Figure *figure;
    const double *numbers, *tables; /* of nodes and of curves */
    const Allowances *allow;
    double gamma; /* relative error of a sum over all neurons, each with what backward counts */
} Network;

#define UNIT 0x1p-53    /* relative error of one rounding */
#define SLIGHTLY 0x1p-40 /* covers 2^13 roundings of a sum of numbers that are not negative */
#define LEAST 1e-280    /* covers what underflows, even where it is flushed to zero; its roundings do not underflow */

/* One node over one box: constant + rows . symbols + rest [-1, 1], and the hull, which may be tighter. Of an affine node
 * size bounds the sum of the absolute values of all that it adds up.
 *
 * The arrays from constant to size are one block of six padded sizes, in this order.
 *
 * A row has `width` coefficients, `stride` apart; behind them stand `fresh` symbols from `first` on that move one
 * neuron each, neuron[k] by radius[k]. */
typedef struct {
    double *constant, *rest, *norm, *lower, *upper, *size;
    double *rows, *radius;
    integer *neuron;
    integer width, stride, first, fresh;
} Model;

/* Memory for the models of one pass. */
typedef struct {
    char *memory;
    size_t used, size;
} Arena;

integer symbols_of(const Network *net); /* at most */
size_t arena_size(const Network *net, integer shared); /* in bytes, where inputs share so many symbols more */
void *take(Arena *arena, size_t count); /* of 8 bytes each */

/* Conditions on arguments of activations, by the node that reads them: NULL where there is none. */
typedef struct {
    const double *lower, *upper; /* (neurons,), at the places of the activation */
} Limits;

static inline integer padded(integer count) { return (count + 7) & ~(integer)7; }
static inline integer diagonal(integer i, integer size) { return i * (padded(size) + 1); }
static inline double least(double a, double b) { return a < b ? a : b; }
static inline double most(double a, double b) { return a > b ? a : b; }
static inline int is_finite(double x) { return x >= -DBL_MAX && x <= DBL_MAX; }
static inline double outward(const Network *net, double x) { return x * (1.0 + SLIGHTLY * net->allow->sums); }

/* dense.c */
/* What goes into six sums over the numbers j that an affine node reads, and what comes out for its neurons. */
enum { OF_CONSTANT, OF_SIZE, OF_REST, OF_MIDDLE, OF_REACH, OF_SIZE_OF_MIDDLE, SUMS };
void give(const Model *model, integer each, double outward, double *given, integer columns);
int conclude(Model *model, integer each, integer size, const double *sums, const double *bias, const double *bias_size,
             double gamma, double outward, double lost); /* tells whether all is finite */
void multiply(double *out, integer stride, integer rows, const double *weight, integer columns, const double *in,
              integer in_stride, integer width, const integer *active, integer count);
void six_sums(double *out, integer stride, const double *w, const double *a, const double *m, const double *given,
              integer columns, const integer *active, integer count);
void add_product(double *out, integer stride, const double *matrix, const double *x, integer columns);
void add_rows(double *out, integer stride, const double *matrix, const double *x, const integer *active, integer count);
void add_fanned(double *out, const double *row, const integer *neuron, const double *radius, integer count);
void scaled_row(double *out, const double *in, double factor, integer count);
void add_scaled(double *out, const double *in, double factor, integer count);
double absolute_sum(const double *row, integer count);
/* What rows of weights come to: the sum of weights times values, and that of their absolute values times sizes. */
typedef struct {
    double sum, size;
} Weighed;
Weighed weigh(const double *row, const double *values, const double *sizes, integer count);
/* The same of weights times one of two values, by their signs; out is added up likewise, of slopes. */
Weighed weigh_by_sign(double *out, const double *row, const double *const above[3], const double *const below[3],
                      integer count);

/* curve.c */
typedef struct {
    double slope, constant, error, rounding; /* |f(x) - slope x - constant| <= error + rounding where it is looked at */
    int exact;                               /* the argument itself, or 0 */
} Line;
int is_known(const Curve *curve, double lower, double upper); /* else numpy has to tell */
double value_on(const Network *net, const Curve *curve, double x);
double slope_on(const Network *net, const Curve *curve, double x);
Line line_on(const Network *net, const Curve *curve, double lower, double upper);
void range_on(const Network *net, const Curve *curve, double lower, double upper, double *low, double *high);
void slopes_on(const Network *net, const Curve *curve, double lower, double upper, double *low, double *high);

/* f(x) - slope x lies in [low, high] where it is looked at, roundings counted. */
typedef struct {
    double low, high;
} Residual;
/* The straight lines that f lies between, each the best of a few in the middle; slope and shift of both. */
typedef struct {
    double below, shift_below, above, shift_above;
} Strip;
Strip strip_on(const Network *net, const Curve *curve, double lower, double upper);
int has_kink(const Network *net, const Curve *curve, double lower, double upper);

/* lines.c */
integer straight_piece(const Network *net, const Curve *curve, double lower, double upper); /* -1 over a break */
Residual residual_on_lines(const Network *net, const Curve *curve, double lower, double upper, double slope);
integer piece_at(const Network *net, const Curve *curve, double x);
double value_on_lines(const Network *net, const Curve *curve, double x);
Line line_on_lines(const Network *net, const Curve *curve, double lower, double upper);
void range_on_lines(const Network *net, const Curve *curve, double lower, double upper, double *low, double *high);
void slopes_on_lines(const Network *net, const Curve *curve, double lower, double upper, double *low, double *high);

/* search.c */
typedef struct {
    double *values, *adjoints;                /* (neurons,), of what was evaluated last */
    double *point, *corner, *evaluated, *sum; /* (inputs,), and one padded node */
} Search;
void forget(Search *search, integer inputs); /* of which network values are */
double climb(const Network *net, const double *lower, const double *upper, integer action, double sign, integer steps,
             double bound, double *best, Search *search);

/* Inputs that move together: constant + sum of shared symbols (a row of inputs for each) + own symbols + rest. */
typedef struct {
    integer shared;
    const double *constant, *rows, *own, *rest, *norm, *lower, *upper;
} Inputs;

/* back.c */
/* Of each neuron of an activation the lines that it lies between, and how large what they add up is; (neurons,) each. */
typedef struct {
    double *above, *shift_above, *size_above, *below, *shift_below, *size_below;
} Strips;
typedef struct {
    Strips strips;
    double *row;     /* (neurons,): weights of what is not yet followed to the inputs */
    double *sums;    /* one padded node */
    integer *active; /* likewise */
    double *sizes;   /* (nodes,): the sum of the absolute values that the neurons of this node and those before may have */
} Back;
integer back_size(const Network *net); /* in numbers */
Back begin_back(const Network *net, double *memory);
void keep_strips(const Network *net, integer index, const Model *models, Back *back);
void keep_size(const Network *net, integer index, const Model *models, Back *back);
double bound_back(const Network *net, const Model *models, integer index, integer neuron, double sign, Back *back);
void meet_back(const Network *net, Model *models, integer index, integer neuron, Back *back);

/* pass.c */
int pass_on(const Network *net, const Inputs *inputs, Model *models, Arena *arena);
int pass(const Network *net, const double *lower, const double *upper, const Limits *limits, const Model *known,
         Model *models, Back *back, Arena *arena);

/* collapse.c */
typedef struct {
    double *centre, *radius, *sums, *weights; /* (neurons,) twice, three padded nodes, and one */
    integer *active;                          /* one padded node */
} Gradient;
void through_affine(const Network *net, const Node *node, const double *centre, const double *radius, double gamma,
                    Gradient *gradient);
int collapse(const Network *net, const Model *models, integer action, double sign, double *lower, double *upper,
             Gradient *gradient); /* tells whether a box became smaller */

/* core.c */
typedef struct {
    Network net;
    integer most, used, sources, roundings; /* kept neurons at most, and what is laid out */
    Node *node;
    Source *source;
    Figure *figure;
    Model *known;                  /* (nodes,): hulls over the box */
    double *numbers, *hulls;
    integer *piece;                /* (neurons,): which piece a neuron lies on, -1 where it is kept */
    integer *kept, *first, *of;    /* kept neurons, where those of a node begin, and of which node those of the core are */
} Core;
integer core_size(const Network *net); /* in numbers */
Core begin_core(const Network *net, double *memory);
int find_core(const Network *net, const Model *models, Gradient *gradient, Core *core); /* tells whether it pays */

/* dual.c */
typedef struct {
    integer neurons, symbols, stride, count; /* at most so many neurons of a node, and what there is */
    double *objective, *tilted, *scratch, *forms, *slack, *beta, *breaks, constant;
} Dual;
double proved_value(const Network *net, Dual *dual); /* what the multipliers in it prove */
void begin_dual(const Network *net, const Model *models, integer action, double sign, Dual *dual);
void add_known(const Network *net, const Model *argument, integer i, double side, double threshold, Dual *dual);
void add_pieces(const Network *net, const Model *models, Dual *dual); /* conditions that hold everywhere */
void improve(Dual *dual, integer sweeps);
double bound_by_duality(const Network *net, const Model *models, integer action, double sign, integer sweeps, Dual *dual);

/* solve.c: finds the best multipliers and symbols e, and tells whether it did; 5 strides and count (count + 4) of work */
int solve_dual(Dual *dual, double *e, double *work);

/* parts.c */
typedef struct {
    integer node, neuron;
    double threshold;
} Split;
Split next_split(const Network *net, const Model *models, const Limits *limits, const Dual *dual);
void relaxed_point(const Network *net, const Model *models, const double *e, const double *lower, const double *upper,
                   double *point);

/* split.c */
/* Conditions of one part: which neuron of which activation is on which side of what. */
typedef struct {
    const integer *node, *neuron, *side;
    const double *threshold;
} Conditions;
typedef struct {
    double bound;
    int solved; /* no multipliers prove more */
    Split next;
} Part;
/* What examining a part needs: limits that hold nothing between calls, symbols, and work for solving. */
typedef struct {
    double *limits, *symbols, *work;
    integer neurons;
} Examining;
integer examining_size(const Network *net, integer depth, integer neurons_of_dual); /* in numbers */
Examining begin_examining(const Network *net, double *memory);
int examine(const Network *net, const double *lower, const double *upper, integer action, double sign,
            const Conditions *known, integer depth, integer sweeps, int exactly, const Model *hulls, Model *models,
            Arena *arena, Dual *dual, Examining *examining, double *point, Part *part);

/* What the largest value of sign times an action over a box is asked with. */
typedef struct {
    const Network *net;
    const double *lower, *upper;
    const Model *hulls; /* that hold over the box */
    double sign, margin;
    integer action, sweeps, parts;
    int exactly;
} Question;
enum { MOST_DEPTH = 64 }; /* of conditions on a part */
typedef struct {
    Model *models;
    Arena *arena;
    Dual *dual;
    Search *search;
    Examining examining;
    double *memory, *point, *best, found; /* splitting_size; where values were looked for, the best of them, and its value */
} Splitting;
integer splitting_size(integer parts);
double split_box(const Question *question, double bound, Splitting *work);

/* program.c */
int deviate(const Network *net, const double *lower, const double *upper, double *work, double *low, double *high,
            double *deviation, double *own_of, double *bound_of, integer last_sum);

#endif
