/* Branch and bound over parts of a box, each with conditions on which side of a threshold arguments lie, see K7. */
#include <string.h>

#include "kernel.h"

integer examining_size(const Network *net, integer depth, integer neurons_of_dual) {
    const integer conditions = depth + 2 * neurons_of_dual * net->trunk, stride = padded(symbols_of(net));
    return 2 * net->neurons + 6 * stride + conditions * (conditions + 4);
}

Examining begin_examining(const Network *net, double *memory) {
    double *symbols = memory + 2 * net->neurons;
    for (integer i = 0; i < net->neurons; i++) memory[i] = -INFINITY, memory[net->neurons + i] = INFINITY;
    return (Examining){memory, symbols, symbols + padded(symbols_of(net)), net->neurons};
}

/* Write limits of arguments, or take them away again. */
static void limit(const Network *net, const Conditions *known, integer depth, double *lower, double *upper, int away) {
    for (integer d = 0; d < depth; d++) {
        if (!known->side[d]) continue;
        const integer at = net->node[known->node[d]].offset + known->neuron[d];
        if (away)
            lower[at] = -INFINITY, upper[at] = INFINITY;
        else if (known->side[d] > 0)
            lower[at] = most(lower[at], known->threshold[d]);
        else
            upper[at] = least(upper[at], known->threshold[d]);
    }
}

/* Tells whether a neuron is held to nothing. */
static int is_empty(const Network *net, const Conditions *known, integer depth, const Model *models,
                    const Limits *limits) {
    for (integer d = 0; d < depth; d++) {
        if (!known->side[d]) continue;
        const Node *node = net->node + known->node[d];
        const Model *argument = models + net->source[node->source].node;
        const integer i = known->neuron[d], at = node->offset + i;
        if (limits->lower[at] > argument->upper[i] || limits->upper[at] < argument->lower[i]) return 1;
    }
    return 0;
}

static Part bound_part(const Network *net, const double *lower, const double *upper, integer action, double sign,
                       const Conditions *known, integer depth, integer sweeps, int exactly, const Model *models,
                       const Limits *held, Dual *dual, Examining *examining, double *point) {
    double *symbols = examining->symbols;
    begin_dual(net, models, action, sign, dual);
    for (integer d = 0; d < depth; d++)
        if (known->side[d])
            add_known(net, models + net->source[net->node[known->node[d]].source].node, known->neuron[d],
                      (double)known->side[d], known->threshold[d], dual);
    add_pieces(net, models, dual);
    improve(dual, sweeps);
    Part part = {.next = next_split(net, models, held, dual)};
    for (integer s = 0; s < dual->symbols; s++)
        symbols[s] = dual->tilted[s] > 0 ? 1.0 : dual->tilted[s] < 0 ? -1.0 : 0.0;
    double proved = least(proved_value(net, dual), INFINITY);
    if (exactly && !part.next.node && dual->count) {
        part.solved = solve_dual(dual, symbols, examining->work);
        proved = least(proved_value(net, dual), proved);
    }
    relaxed_point(net, models, symbols, lower, upper, point);
    const Model *last = models + net->trunk - 1;
    part.bound = least(proved, sign > 0 ? last->upper[action] : -last->lower[action]);
    if (is_empty(net, known, depth, models, held)) part.bound = -INFINITY;
    return part;
}

/* Bound one part; tells whether it could. `hulls` hold over the whole box, if they are there. */
int examine(const Network *net, const double *lower, const double *upper, integer action, double sign,
            const Conditions *known, integer depth, integer sweeps, int exactly, const Model *hulls, Model *models,
            Arena *arena, Dual *dual, Examining *examining, double *point, Part *part) {
    double *low = examining->limits, *high = low + examining->neurons;
    const Limits held = {low, high};
    limit(net, known, depth, low, high, 0);
    const int done = pass(net, lower, upper, &held, hulls, models, NULL, arena);
    if (done)
        *part = bound_part(net, lower, upper, action, sign, known, depth, sweeps, exactly, models, &held, dual, examining,
                           point);
    limit(net, known, depth, low, high, 1);
    return done;
}

/* A part that was examined: what holds in it besides what holds in its parent (-1: nothing), and what is known. */
typedef struct {
    integer parent, depth, node, neuron, side, open;
    double threshold, bound;
    Split next;
} Leaf;

integer splitting_size(integer parts) { return (integer)sizeof(Leaf) / 8 * (parts + 2) + 4 * MOST_DEPTH; }

static Conditions conditions_of(const Leaf *leaves, const Leaf *leaf, double *memory) {
    integer *node = (integer *)(void *)memory, *neuron = node + MOST_DEPTH, *side = neuron + MOST_DEPTH;
    double *threshold = memory + 3 * MOST_DEPTH;
    for (integer d = leaf->depth; d-- > 0; leaf = leaves + leaf->parent)
        node[d] = leaf->node, neuron[d] = leaf->neuron, side[d] = leaf->side, threshold[d] = leaf->threshold;
    return (Conditions){node, neuron, side, threshold};
}

/* Bound a leaf by its parent's bound and by what examining it says, and take in the value that it leads to. */
static void look_at(const Question *question, Leaf *leaves, Leaf *leaf, Splitting *work) {
    const Network *net = question->net;
    const Conditions known = conditions_of(leaves, leaf, work->memory);
    Part part;
    leaf->next.node = 0;
    if (!examine(net, question->lower, question->upper, question->action, question->sign, &known, leaf->depth,
                 question->sweeps, question->exactly, question->hulls, work->models, work->arena, work->dual,
                 &work->examining, work->point, &part))
        return;
    leaf->bound = least(part.bound, leaf->bound), leaf->next = part.next;
    const double value = climb(net, question->lower, question->upper, question->action, question->sign, 0, INFINITY,
                               work->point, work->search);
    if (value > work->found) {
        work->found = value;
        memcpy(work->best, work->point, (size_t)net->node[0].size * 8);
    }
}

/* The largest bound of parts that cover the box, split until they are within the margin or the effort is spent. */
double split_box(const Question *question, double bound, Splitting *work) {
    Leaf *leaves = (Leaf *)(void *)(work->memory + 4 * MOST_DEPTH);
    integer count = 1;
    double closed = -INFINITY;
    leaves[0] = (Leaf){.parent = -1, .open = 1, .bound = bound};
    look_at(question, leaves, leaves, work);
    for (;;) {
        Leaf *loosest = NULL;
        for (integer k = 0; k < count; k++)
            if (leaves[k].open && (!loosest || leaves[k].bound > loosest->bound)) loosest = leaves + k;
        if (!loosest) return most(closed, work->found);
        const int done = loosest->bound <= work->found + question->margin;
        if (done || count + 2 > question->parts) return most(most(closed, loosest->bound), work->found);
        loosest->open = 0;
        if (!loosest->next.node || loosest->depth == MOST_DEPTH) {
            closed = most(closed, loosest->bound);
            continue;
        }
        for (integer side = -1; side <= 1; side += 2) {
            leaves[count] = (Leaf){loosest - leaves, loosest->depth + 1, loosest->next.node, loosest->next.neuron, side, 1,
                                   loosest->next.threshold, loosest->bound, {0}};
            look_at(question, leaves, leaves + count++, work);
        }
    }
}
