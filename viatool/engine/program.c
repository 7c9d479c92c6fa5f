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
    for (integer i = 0; i < node->size; i++) {
        const integer at = node->offset + i;
        const double own = outward(net, rounded(net, index, outward(net, size[i]), factor[i], flushed[i]));
        const double bound = outward(net, rest[i] + own) + LEAST * net->allow->underflow;
        double low = down(lower[at] - bound), high = up(upper[at] + bound);
        if (node->elementwise) { /* what it makes of the program's number itself may be nearer */
            const Source *source = net->source + node->source;
            const integer before = net->node[source->node].offset + i;
            const double w = net->numbers[source->weight + diagonal(i, node->size)];
            const double one = w * program->low[before], other = w * program->high[before];
            const double reach = own + net->figure[index].gamma * net->allow->sums * size[i] + LEAST * net->allow->underflow;
            low = most(low, down(bias[i] + least(one, other) - outward(net, reach)));
            high = least(high, up(bias[i] + most(one, other) + outward(net, reach)));
        }
        program->own[at] = own, program->bound[at] = bound;
        program->low[at] = most(low, net->numbers[node->floor + i]), program->high[at] = high;
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

/* Returns 0 where the precision of a node may not hold what the program has. */
int deviate(const Network *net, const double *lower, const double *upper, double *work, double *low, double *high,
            double *deviation, double *own_of, double *bound_of, integer last_sum) {
    Program program = {work, work + net->neurons, work + 2 * net->neurons, work + 3 * net->neurons,
                       work + 4 * net->neurons};
    for (integer i = 0; i < net->neurons; i++)
        if (!is_finite(lower[i]) || !is_finite(upper[i]) || lower[i] > upper[i]) return 0;
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
        for (integer i = node->offset; i < node->offset + node->size; i++)
            if (!(magnitude(lower[i], upper[i]) + program.bound[i] < figure->largest) || !is_finite(program.low[i]) ||
                !is_finite(program.high[i]))
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
