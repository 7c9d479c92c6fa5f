/* The best multipliers of a dual bound, by a primal-dual interior point method. Whatever it finds, K7 proves the bound.
 *
 * max objective . e, form_d . e + slack_d = w_d >= 0, -1 <= e <= 1; beta, y and z are the multipliers of w, 1 - e, 1 + e.
 */
#include <string.h>

#include "kernel.h"

enum { MOST_STEPS = 40 };

static const double CENTRED = 0.1, SHARE = 0.95, SOLVED = 1e-9;

/* Solve matrix x = right, symmetric and positive definite, both overwritten; 0 where it is not. */
static int solve_system(double *matrix, double *right, integer count) {
    for (integer i = 0; i < count; i++)
        for (integer j = 0; j <= i; j++) {
            double sum = matrix[i * count + j];
            for (integer k = 0; k < j; k++) sum -= matrix[i * count + k] * matrix[j * count + k];
            if (i > j)
                matrix[i * count + j] = sum / matrix[j * count + j];
            else if (sum > 0.0)
                matrix[i * count + i] = sqrt(sum);
            else
                return 0;
        }
    for (integer i = 0; i < count; i++) {
        for (integer k = 0; k < i; k++) right[i] -= matrix[i * count + k] * right[k];
        right[i] /= matrix[i * count + i];
    }
    for (integer i = count; i-- > 0;) {
        for (integer k = i + 1; k < count; k++) right[i] -= matrix[k * count + i] * right[k];
        right[i] /= matrix[i * count + i];
    }
    return 1;
}

static double dot(const double *a, const double *b, integer count) {
    double sum = 0.0;
    for (integer k = 0; k < count; k++) sum += a[k] * b[k];
    return sum;
}

/* The longest step, up to 1, that keeps a number positive. */
static double held(double step, double value, double change) {
    return change < 0.0 ? least(step, -SHARE * value / change) : step;
}

int solve_dual(Dual *dual, double *e, double *work) {
    const integer symbols = dual->symbols, count = dual->count, stride = dual->stride;
    double *y = work, *z = y + stride, *theta = z + stride, *rest = theta + stride, *de = rest + stride;
    double *w = de + stride, *dw = w + count, *dbeta = dw + count, *missing = dbeta + count, *matrix = missing + count;
    double largest = 0.0;
    for (integer s = 0; s < symbols; s++) largest = most(largest, fabs(dual->objective[s]));
    if (largest == 0.0 || !count) return 0;
    for (integer s = 0; s < symbols; s++) e[s] = 0.0, y[s] = z[s] = largest;
    for (integer d = 0; d < count; d++) {
        const double norm = absolute_sum(dual->forms + d * stride, symbols);
        w[d] = most(dual->slack[d], 0.1 * norm + 1e-280), dual->beta[d] = largest / (norm + 1e-280);
    }
    for (integer step = 0; step < MOST_STEPS; step++) {
        double gap = 0.0, off = 0.0;
        for (integer s = 0; s < symbols; s++) {
            gap += y[s] * (1.0 - e[s]) + z[s] * (1.0 + e[s]);
            rest[s] = dual->objective[s] - y[s] + z[s];
        }
        for (integer d = 0; d < count; d++) {
            const double *form = dual->forms + d * stride;
            gap += w[d] * dual->beta[d];
            add_scaled(rest, form, dual->beta[d], symbols);
            missing[d] = dot(form, e, symbols) + dual->slack[d] - w[d];
            off = most(off, fabs(missing[d]) * dual->beta[d]);
        }
        for (integer s = 0; s < symbols; s++) off = most(off, fabs(rest[s]));
        if (!is_finite(gap)) return 0;
        if (gap <= SOLVED * largest && off <= SOLVED * largest) return 1;
        const double mu = CENTRED * gap / (double)(2 * symbols + count);
        for (integer s = 0; s < symbols; s++) {
            const double up = 1.0 - e[s], down = 1.0 + e[s];
            theta[s] = 1.0 / (y[s] / up + z[s] / down);
            rest[s] += y[s] - z[s] - mu / up + mu / down;
        }
        for (integer d = 0; d < count; d++) {
            const double *form = dual->forms + d * stride;
            for (integer s = 0; s < symbols; s++) de[s] = form[s] * theta[s];
            for (integer k = 0; k <= d; k++) matrix[d * count + k] = dot(de, dual->forms + k * stride, symbols);
            matrix[d * count + d] += w[d] / dual->beta[d];
            dbeta[d] = mu / dual->beta[d] - w[d] - missing[d] - dot(de, rest, symbols);
        }
        if (!solve_system(matrix, dbeta, count)) return 0;
        memcpy(de, rest, (size_t)symbols * 8);
        for (integer d = 0; d < count; d++) add_scaled(de, dual->forms + d * stride, dbeta[d], symbols);
        double ahead = 1.0, behind = 1.0;
        for (integer s = 0; s < symbols; s++) {
            const double up = 1.0 - e[s], down = 1.0 + e[s];
            de[s] *= theta[s];
            ahead = held(held(ahead, up, -de[s]), down, de[s]);
            const double dy = (mu + y[s] * de[s]) / up - y[s], dz = (mu - z[s] * de[s]) / down - z[s];
            behind = held(held(behind, y[s], dy), z[s], dz);
            theta[s] = dy, rest[s] = dz;
        }
        for (integer d = 0; d < count; d++) {
            dw[d] = dot(dual->forms + d * stride, de, symbols) + missing[d];
            ahead = held(ahead, w[d], dw[d]), behind = held(behind, dual->beta[d], dbeta[d]);
        }
        for (integer s = 0; s < symbols; s++) e[s] += ahead * de[s], y[s] += behind * theta[s], z[s] += behind * rest[s];
        for (integer d = 0; d < count; d++) w[d] += ahead * dw[d], dual->beta[d] += behind * dbeta[d];
    }
    return 0;
}
