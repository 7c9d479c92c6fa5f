/* What Python calls: chunks of states, each by itself. A state that the kernel leaves to numpy has `done` 0. */
#include <fenv.h>
#include <stdlib.h>
#include <string.h>

#include "kernel.h"

#define EXPORTED __attribute__((visibility("default")))

EXPORTED const char *viatool_digest(void) { return VIATOOL_DIGEST; }

static integer neurons_of_trunk(const Network *net) {
    const Node *last = net->node + net->trunk - 1;
    return last->offset + last->size;
}

static integer widest_of(const Network *net, integer nodes) {
    integer widest = 0;
    for (integer k = 0; k < nodes; k++)
        if (net->node[k].size > widest) widest = net->node[k].size;
    return widest;
}

/* What the questions about one state need, all in one piece of memory. */
typedef struct {
    Model *models, *shrunk;
    Arena arena, shrunk_arena;
    Search search;
    Gradient gradient;
    Dual dual;
    Back back;
    Core core;
    Splitting splitting;
    void *memory;
} Workspace;

static int begin_work(const Network *net, integer neurons_of_dual, integer parts, integer known, Workspace *work) {
    const integer inputs = net->node[0].size, all = neurons_of_trunk(net), each = padded(widest_of(net, net->trunk));
    const integer layers = net->trunk, most_conditions = known + 2 * neurons_of_dual * layers;
    const integer stride = padded(symbols_of(net)), size = (integer)arena_size(net, 0) / 8;
    const integer models = (integer)sizeof(Model) / 8 * net->trunk;
    const integer search = 2 * all + 3 * inputs + each, gradient = 2 * all + 5 * each;
    const integer dual = (most_conditions + 5) * stride + 2 * most_conditions;
    const integer examining = parts ? examining_size(net, known, neurons_of_dual) : 0;
    const integer splitting = examining + splitting_size(parts) + inputs;
    double *next = work->memory = aligned_alloc(64, (size_t)padded(2 * (size + models) + search + gradient + dual + back_size(net) + core_size(net) + splitting) *
                                                     8);
    if (!next) return 0;
    work->arena = (Arena){(char *)next, 0, (size_t)size * 8}, next += size;
    work->shrunk_arena = (Arena){(char *)next, 0, (size_t)size * 8}, next += size;
    work->models = (Model *)next, next += models;
    work->shrunk = (Model *)next, next += models;
    memset(next, 0, (size_t)(search + gradient) * 8);
    double *point = next + 2 * all;
    work->search = (Search){next, next + all, point, point + inputs, point + 2 * inputs, point + 3 * inputs};
    next += search, forget(&work->search, inputs);
    work->gradient = (Gradient){next, next + all, next + 2 * all, next + 2 * all + 3 * each,
                                (integer *)(void *)(next + 2 * all + 4 * each)};
    next += gradient;
    work->dual = (Dual){.neurons = neurons_of_dual, .stride = stride, .objective = next, .tilted = next + stride,
                        .scratch = next + 2 * stride, .breaks = next + 3 * stride, .forms = next + 5 * stride};
    work->dual.slack = next + (most_conditions + 5) * stride, work->dual.beta = work->dual.slack + most_conditions;
    work->back = begin_back(net, next + dual), work->core = begin_core(net, next + dual + back_size(net));
    next += dual + back_size(net) + core_size(net);
    if (parts) work->splitting = (Splitting){.examining = begin_examining(net, next), .memory = next + examining};
    if (parts) work->splitting.point = work->splitting.memory + splitting_size(parts);
    return fegetround() == FE_TONEAREST;
}

static double seeded(const Network *net, const Model *models, integer action, double sign) {
    const Model *last = models + net->trunk - 1;
    return sign > 0 ? last->upper[action] : -last->lower[action];
}

/* Shrink the box of a question while the action is monotone in inputs; returns the models of the last box. */
static const Model *shrink(const Network *net, Workspace *work, integer rounds, integer action, double sign,
                           double *lower, double *upper, double *bound) {
    const Model *models = work->models;
    for (integer round = 0; round < rounds; round++) {
        if (!collapse(net, models, action, sign, lower, upper, &work->gradient)) break;
        if (!pass(net, lower, upper, NULL, work->models, work->shrunk, NULL, &work->shrunk_arena)) return NULL;
        models = work->shrunk;
        *bound = least(*bound, seeded(net, models, action, sign));
        if (!models[0].fresh) break;
    }
    return models;
}

/* How hard viatool_bound tries; all fields have 8 bytes. */
typedef struct {
    integer rounds, sweeps, neurons_of_dual, whole, backwards, climbs; /* see taylor/kernel.py */
    integer parts, exactly;
    double tolerance;
} Effort;

/* Where the answers to all questions about all boxes go. */
typedef struct {
    double *face_lower, *face_upper, *bound, *points, *found;
} Answers;

/* The network that questions about a box are asked of, with its models over the whole box: the core, where there is one. */
static const Network *inner_network(const Network *net, const double *lower, const double *upper, const Effort *effort,
                                    Workspace *work) {
    Core *core = &work->core;
    if (!effort->rounds || !find_core(net, work->models, &work->gradient, core)) return net;
    if (arena_size(&core->net, 0) > work->arena.size) return net;
    if (pass(&core->net, lower, upper, NULL, core->known, work->shrunk, NULL, &work->shrunk_arena)) {
        Model *models = work->models;
        const Arena arena = work->arena;
        work->models = work->shrunk, work->arena = work->shrunk_arena;
        work->shrunk = models, work->shrunk_arena = arena;
        return &core->net;
    }
    return net;
}

/* Move a point to where the model of an action alone is largest. */
static void best_corner(const Network *net, const Model *models, integer action, double sign, const double *lower,
                        const double *upper, double *point) {
    const Model *last = models + net->trunk - 1, *input = models;
    for (integer k = 0; k < input->fresh && last->width; k++) {
        const double slope = sign * last->rows[action * last->stride + k];
        const integer i = input->neuron[k];
        if (slope != 0.0) point[i] = slope > 0.0 ? upper[i] : lower[i];
    }
}

static void ask(const Network *net, const Effort *effort, integer action, double sign, const double *lower,
                const double *upper, integer at, const Answers *answers, Workspace *work) {
    const integer inputs = net->node[0].size;
    double *left = answers->face_lower + at * inputs, *right = answers->face_upper + at * inputs;
    double *point = answers->points + at * inputs, *bound = answers->bound + at, *found = answers->found + at;
    memcpy(left, lower, (size_t)inputs * 8), memcpy(right, upper, (size_t)inputs * 8);
    *bound = seeded(net, work->models, action, sign);
    if (effort->whole) /* the dual bound over the whole box, before it is shrunk */
        *bound = least(*bound, bound_by_duality(net, work->models, action, sign, 1, &work->dual));
    const Model *models = shrink(net, work, effort->rounds, action, sign, left, right, bound);
    for (integer i = 0; i < inputs; i++) point[i] = left[i] / 2 + right[i] / 2;
    if (!effort->rounds) best_corner(net, work->models, action, sign, lower, upper, point);
    *found = climb(net, lower, upper, action, sign, effort->climbs, *bound, point, &work->search);
    if (effort->sweeps && models && models[0].fresh && *bound > *found + 1e-12 * fabs(*found))
        *bound = least(*bound, bound_by_duality(net, models, action, sign, effort->sweeps, &work->dual));
}

/* Split the boxes of questions about one state (of `count`) that stay loose. */
static void split_loose(const Network *net, const Effort *effort, integer count, integer state, const Answers *answers,
                        Workspace *work) {
    const integer inputs = net->node[0].size, actions = net->node[net->trunk - 1].size;
    Splitting *splitting = &work->splitting;
    splitting->models = work->shrunk, splitting->arena = &work->shrunk_arena;
    splitting->dual = &work->dual, splitting->search = &work->search;
    for (integer q = 0; q < 2 * actions; q++) {
        const integer at = q * count + state, other = (q + actions) % (2 * actions) * count + state;
        const double width = answers->found[at] + answers->found[other];
        const double margin = effort->tolerance * width + 1e-12 * fabs(answers->found[at]);
        if (!(answers->bound[at] > answers->found[at] + margin)) continue;
        const Question question = {net, answers->face_lower + at * inputs, answers->face_upper + at * inputs, work->models,
                                   q < actions ? 1.0 : -1.0, margin, q % actions, effort->sweeps, effort->parts,
                                   (int)effort->exactly};
        splitting->found = answers->found[at], splitting->best = answers->points + at * inputs;
        answers->bound[at] = least(answers->bound[at], split_box(&question, answers->bound[at], splitting));
        answers->found[at] = splitting->found;
    }
}

EXPORTED int viatool_bound(const Network *net, const Effort *effort, integer count, const double *lower,
                           const double *upper, double *hull_lower, double *hull_upper, double *face_lower,
                           double *face_upper, double *bound, double *points, double *found, uint8_t *done,
                           uint8_t *settled) {
    const integer inputs = net->node[0].size, neurons = neurons_of_trunk(net);
    const integer actions = net->node[net->trunk - 1].size;
    const Answers answers = {face_lower, face_upper, bound, points, found};
    Workspace work;
    const integer parts = core_size(net) ? effort->parts : 0;
    const int ready = begin_work(net, effort->neurons_of_dual, parts, parts ? MOST_DEPTH : 0, &work);
    for (integer b = 0; ready && b < count; b++) {
        const double *low = lower + b * inputs, *high = upper + b * inputs;
        done[b] = (uint8_t)pass(net, low, high, NULL, NULL, work.models, effort->backwards ? &work.back : NULL, &work.arena);
        if (!done[b]) continue;
        for (integer k = 0; k < net->trunk; k++) {
            const integer at = b * neurons + net->node[k].offset;
            memcpy(hull_lower + at, work.models[k].lower, (size_t)net->node[k].size * 8);
            memcpy(hull_upper + at, work.models[k].upper, (size_t)net->node[k].size * 8);
        }
        const Network *inner = inner_network(net, low, high, effort, &work);
        forget(&work.search, inputs);
        for (integer q = 0; q < 2 * actions; q++)
            ask(inner, effort, q % actions, q < actions ? 1.0 : -1.0, low, high, q * count + b, &answers, &work);
        if (inner == net) continue;
        settled[b] = parts > 0;
        if (parts) split_loose(inner, effort, count, b, &answers, &work);
        forget(&work.search, inputs); /* what is attained is a value of the network itself */
        for (integer q = 0; q < 2 * actions; q++) {
            const integer at = q * count + b;
            found[at] = climb(net, low, high, q % actions, q < actions ? 1.0 : -1.0, 0, INFINITY, points + at * inputs,
                              &work.search);
        }
    }
    free(work.memory);
    return ready;
}

/* What back-substitution alone says of the actions, by itself so that a test can compare it with exact arithmetic. */
EXPORTED int viatool_back(const Network *net, integer count, const double *lower, const double *upper, double *low,
                          double *high, uint8_t *done) {
    const integer inputs = net->node[0].size, actions = net->node[net->trunk - 1].size;
    Workspace work;
    const int ready = begin_work(net, 0, 0, 0, &work);
    for (integer b = 0; ready && b < count; b++) {
        done[b] = (uint8_t)pass(net, lower + b * inputs, upper + b * inputs, NULL, NULL, work.models, NULL, &work.arena);
        for (integer k = 0; done[b] && k < net->trunk; k++) {
            if (net->node[k].kind == ACTIVATION) keep_strips(net, k, work.models, &work.back);
            keep_size(net, k, work.models, &work.back);
        }
        for (integer i = 0; done[b] && i < actions; i++) {
            high[b * actions + i] = bound_back(net, work.models, net->trunk - 1, i, 1.0, &work.back);
            low[b * actions + i] = -bound_back(net, work.models, net->trunk - 1, i, -1.0, &work.back);
        }
    }
    free(work.memory);
    return ready;
}

/* What the actions are of the symbols that the inputs share, and how large the rest is of each. */
EXPORTED int viatool_linear(const Network *net, integer count, integer shared, const double *constant, const double *rows,
                            const double *own, const double *rest, const double *norm, const double *lower,
                            const double *upper, double *hull_lower, double *hull_upper, double *centre, double *slope,
                            double *others, double *size, uint8_t *done) {
    const integer inputs = net->node[0].size, neurons = neurons_of_trunk(net);
    const integer actions = net->node[net->trunk - 1].size;
    const size_t models_size = (sizeof(Model) * (size_t)net->trunk + 63) & ~(size_t)63;
    const size_t bytes = arena_size(net, shared);
    char *memory = aligned_alloc(64, models_size + bytes);
    Arena arena = {memory + models_size, 0, bytes};
    Model *models = (Model *)(void *)memory;
    const int ready = memory && fegetround() == FE_TONEAREST;
    for (integer b = 0; ready && b < count; b++) {
        const integer at = b * inputs;
        const Inputs given = {shared, constant + at, rows + b * shared * inputs, own + at, rest + at, norm + at,
                              lower + at, upper + at};
        done[b] = (uint8_t)pass_on(net, &given, models, &arena);
        if (!done[b]) continue;
        for (integer k = 0; k < net->trunk; k++) {
            const integer to = b * neurons + net->node[k].offset;
            memcpy(hull_lower + to, models[k].lower, (size_t)net->node[k].size * 8);
            memcpy(hull_upper + to, models[k].upper, (size_t)net->node[k].size * 8);
        }
        const Model *last = models + net->trunk - 1;
        for (integer a = 0; a < actions; a++) {
            const double *row = last->rows + a * last->stride;
            double beside = 0.0;
            for (integer s = 0; s < shared; s++) slope[(b * shared + s) * actions + a] = s < last->width ? row[s] : 0.0;
            for (integer s = shared; s < last->width; s++) beside += fabs(row[s]);
            for (integer k = 0; k < last->fresh; k++)
                if (last->neuron[k] == a) beside += fabs(last->radius[k]);
            centre[b * actions + a] = last->constant[a];
            others[b * actions + a] = outward(net, beside + last->rest[a]);
            size[b * actions + a] = outward(net, fabs(last->constant[a]) + last->norm[a] + last->rest[a]);
        }
    }
    free(memory);
    return ready;
}

enum { SOLVED_EXACTLY = 2 }; /* of what is done: no multipliers prove more */

EXPORTED int viatool_examine(const Network *net, integer count, integer depth, const double *lower, const double *upper,
                             const integer *action, const double *sign, const integer *node, const integer *neuron,
                             const integer *side, const double *threshold, integer sweeps, integer neurons_of_dual,
                             integer exactly,
                             double *bound, double *points, integer *next_node, integer *next_neuron,
                             double *next_threshold, uint8_t *done) {
    const integer inputs = net->node[0].size;
    Workspace work;
    double *memory = malloc((size_t)examining_size(net, depth, neurons_of_dual) * 8);
    const int ready = begin_work(net, neurons_of_dual, 0, depth, &work) && memory;
    Examining examining = {0};
    if (ready) examining = begin_examining(net, memory);
    for (integer k = 0; ready && k < count; k++) {
        const Conditions known = {node + k * depth, neuron + k * depth, side + k * depth, threshold + k * depth};
        Part part;
        done[k] = (uint8_t)examine(net, lower + k * inputs, upper + k * inputs, action[k], sign[k], &known, depth, sweeps,
                                   (int)exactly, NULL, work.models, &work.arena, &work.dual, &examining,
                                   points + k * inputs, &part);
        if (!done[k]) continue;
        if (part.solved) done[k] = SOLVED_EXACTLY;
        bound[k] = part.bound;
        next_node[k] = part.next.node, next_neuron[k] = part.next.neuron, next_threshold[k] = part.next.threshold;
    }
    free(work.memory), free(memory);
    return ready;
}

EXPORTED int viatool_deviate(const Network *net, integer count, const double *lower, const double *upper, double *low,
                             double *high, double *deviation, double *own, double *bound, integer last_sum) {
    const integer actions = net->node[net->nodes - 1].size, sums = last_sum < 0 ? 0 : net->node[last_sum].size;
    double *work = calloc((size_t)(4 * net->neurons + 3 * padded(widest_of(net, net->nodes))), 8);
    int ready = work && fegetround() == FE_TONEAREST;
    for (integer b = 0; ready && b < count; b++)
        ready = deviate(net, lower + b * net->neurons, upper + b * net->neurons, work, low + b * actions,
                        high + b * actions, deviation + b * actions, own + b * sums, bound + b * sums, last_sum);
    free(work);
    return ready;
}

/* The bound that given multipliers prove, by itself so that a test can compare it with exact arithmetic. */
EXPORTED int viatool_dual(const Network *net, integer symbols, integer count, const double *constant,
                          const double *objective, const double *forms, const double *slack, const double *beta,
                          double *bound) {
    double *tilted = malloc((size_t)symbols * 8);
    if (!tilted) return 0;
    Dual dual = {.symbols = symbols, .stride = symbols, .count = count, .objective = (double *)objective,
                 .tilted = tilted, .forms = (double *)forms, .slack = (double *)slack, .beta = (double *)beta,
                 .constant = *constant};
    *bound = proved_value(net, &dual);
    free(tilted);
    return 1;
}
