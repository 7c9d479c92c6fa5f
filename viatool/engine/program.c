/* What the deployed program's rounding makes of the network, by norms alone, see K8. */


#include "kernel.h"

typedef struct {
    double *bound, *own, *low, *high; /* (neurons,): of the deviation, its own error, and what the program has */
    double *sums;                     /* of one node, and the numbers that it reads */
} Program;

static double down(double x) { return x - (fabs(x) * (4 * UNIT) + LEAST); }
static double up(double x) { return x + (fabs(x) * (4 * UNIT) + LEAST); }
static double magnitude(double low, double high) { return most(fabs(low), fabs(high)); }

/* Own error of what is at most `size` large, or a number that is not finite where the precision may not hold that. */
static double rounded(const Network *net, integer index, double size, double relative, double flushed) {
    return size < net->figure[index].largest ? (relative * size + flushed) * net->allow->program : INFINITY;
}

/* What an affine node adds up: deviations that reach it, sizes, what these err by, its hull, and its least values. */
typedef struct {
    const double *rest, *size, *factor, *flushed, *lower, *upper, *floor;
} Sums;

/* The deviation of each neuron, its own error, and what the program has of it. */
EVERY_PROCESSOR
static void conclude_sums(integer count, const Sums *sums, double largest, double program, double outward, double lost,
                          double *restrict own, double *restrict bound, double *restrict low, double *restrict high) {
    const double *restrict rest = sums->rest, *restrict size = sums->size, *restrict factor = sums->factor;
    const double *restrict flushed = sums->flushed, *restrict lower = sums->lower, *restrict upper = sums->upper;
    const double *restrict floor = sums->floor;
    for (integer i = 0; i < count; i++) {
        const double all = size[i] * outward, error = (factor[i] * all + flushed[i]) * program * outward;
        own[i] = all < largest ? error : INFINITY;
        bound[i] = (rest[i] + own[i]) * outward + lost;
        low[i] = most(down(lower[i] - bound[i]), floor[i]), high[i] = up(upper[i] + bound[i]);
    }
}

static void enter_affine(const Network *net, integer index, const double *lower, const double *upper, Program *program) {
    const Node *node = net->node + index;
    const integer each = padded(node->size);
    const double *bias = net->numbers + node->bias, *bias_size = net->numbers + node->bias_size;
    const double *factor = net->numbers + node->factor, *flushed = net->numbers + node->flushed;
    double *rest = program->sums, *size = rest + each, *held = size + each;
    for (integer i = 0; i < each; i++) rest[i] = 0.0, size[i] = i < node->size ? bias_size[i] : 0.0;
    for (integer k = 0; k < node->sources; k++) {
        const Source *source = net->source + node->source + k;
        const integer before = net->node[source->node].offset, columns = net->node[source->node].size;
        const double *moved = program->bound + before;
        for (integer j = 0; j < columns; j++) held[j] = magnitude(program->low[before + j], program->high[before + j]);
        if (node->elementwise)
            for (integer i = 0; i < node->size; i++) {
                rest[i] += net->numbers[source->absolute + diagonal(i, node->size)] * moved[i];
                size[i] += net->numbers[source->merged + diagonal(i, node->size)] * held[i];
            }
        else {
            add_product(rest, each, net->numbers + source->absolute_t, moved, columns);
            add_product(size, each, net->numbers + source->merged_t, held, columns);
        }
    }
    const integer at = node->offset;
    const Sums sums = {rest, size, factor, flushed, lower + at, upper + at, net->numbers + node->floor};
    const double lost = LEAST * net->allow->underflow;
    conclude_sums(node->size, &sums, net->figure[index].largest, net->allow->program, outward(net, 1.0), lost,
                  program->own + at, program->bound + at, program->low + at, program->high + at);
    for (integer i = 0; node->elementwise && i < node->size; i++) {
        const Source *source = net->source + node->source; /* what it makes of the program's number itself may be nearer */
        const integer before = net->node[source->node].offset + i;
        const double w = net->numbers[source->weight + diagonal(i, node->size)];
        const double one = w * program->low[before], other = w * program->high[before];
        const double reach = program->own[at + i] + net->figure[index].gamma * net->allow->sums * size[i] + lost;
        program->low[at + i] = most(program->low[at + i], down(bias[i] + least(one, other) - outward(net, reach)));
        program->high[at + i] = least(program->high[at + i], up(bias[i] + most(one, other) + outward(net, reach)));
    }
}

static int enter_activation(const Network *net, integer index, const double *lower, const double *upper, Program *program) {
    const Node *node = net->node + index;
    const Figure *figure = net->figure + index;
    const Curve *curve = net->curve + node->curve;
    const integer before = net->node[net->source[node->source].node].offset;
    for (integer i = 0; i < node->size; i++) {
        const integer at = node->offset + i;
        const double low = program->low[before + i], high = program->high[before + i], moved = program->bound[before + i];
        if (!is_known(curve, low, high)) return 0;
        double flattest, steepest, least_value, most_value;
        slopes_on(net, curve, low, high, &flattest, &steepest);
        range_on(net, curve, low, high, &least_value, &most_value);
        if (!is_finite(flattest) || !is_finite(steepest)) return 0;
        const double value = magnitude(least_value, most_value);
        double scale = most(1.0, value);
        if (node->error == OF_THE_LARGEST) scale = figure->amplitude * most(scale, magnitude(low, high));
        const double relative = node->error == EXACT ? 0.0 : figure->error_units * figure->unit;
        if (!(value < figure->largest)) return 0;
        const double own = outward(net, relative * scale * net->allow->program);
        const double passed = least(magnitude(flattest, steepest) * moved, most_value - least_value);
        const double bound = outward(net, passed + own) + LEAST * net->allow->underflow * (node->error != EXACT || moved > 0);
        program->own[at] = own, program->bound[at] = bound;
        program->low[at] = most(most(down(lower[at] - bound), down(least_value - own)), net->numbers[node->floor + i]);
        program->high[at] = least(up(upper[at] + bound), up(most_value + own));
    }
    return 1;
}

EVERY_PROCESSOR
static int in_order(const double *restrict lower, const double *restrict upper, integer count) {
    integer wrong = 0;
    for (integer i = 0; i < count; i++) wrong |= !((lower[i] <= upper[i]) & (lower[i] >= -DBL_MAX) & (upper[i] <= DBL_MAX));
    return !wrong;
}

/* Tells whether a precision holds all that the program may have of a node. */
EVERY_PROCESSOR
static int is_held(integer count, const double *restrict lower, const double *restrict upper, const double *restrict bound,
                   const double *restrict low, const double *restrict high, double largest) {
    integer wrong = 0;
    for (integer i = 0; i < count; i++) {
        wrong |= !(magnitude(lower[i], upper[i]) + bound[i] < largest);
        wrong |= !((fabs(low[i]) <= DBL_MAX) & (fabs(high[i]) <= DBL_MAX));
    }
    return !wrong;
}

/* Returns 0 where the precision of a node may not hold what the program has. */
int deviate(const Network *net, const double *lower, const double *upper, double *work, double *low, double *high,
            double *deviation, double *own_of, double *bound_of, integer last_sum) {
    Program program = {work, work + net->neurons, work + 2 * net->neurons, work + 3 * net->neurons,
                       work + 4 * net->neurons};
    if (!in_order(lower, upper, net->neurons)) return 0;
    for (integer index = 0; index < net->nodes; index++) {
        const Node *node = net->node + index;
        const Figure *figure = net->figure + index;
        if (node->kind == INPUT)
            for (integer i = 0; i < node->size; i++) {
                const double own = rounded(net, index, magnitude(lower[i], upper[i]), figure->unit, figure->tiny);
                program.own[i] = program.bound[i] = outward(net, own);
                program.low[i] = most(down(lower[i] - program.bound[i]), net->numbers[node->floor + i]);
                program.high[i] = up(upper[i] + program.bound[i]);
            }
        else if (node->kind == AFFINE)
            enter_affine(net, index, lower, upper, &program);
        else if (!enter_activation(net, index, lower, upper, &program))
            return 0;
        const integer at = node->offset;
        if (!is_held(node->size, lower + at, upper + at, program.bound + at, program.low + at, program.high + at,
                     figure->largest))
            return 0;
        if (index == last_sum)
            for (integer i = 0; i < node->size; i++)
                own_of[i] = program.own[node->offset + i], bound_of[i] = program.bound[node->offset + i];
    }
    const Node *last = net->node + net->nodes - 1;
    for (integer i = 0; i < last->size; i++) {
        low[i] = program.low[last->offset + i], high[i] = program.high[last->offset + i];
        deviation[i] = program.bound[last->offset + i];
    }
    return 1;
}
