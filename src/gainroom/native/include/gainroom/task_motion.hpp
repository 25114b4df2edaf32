// Motion that contacts leave, and tasks by strict priority on it: robot/contact.py and robot/tasks.py have the theory.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "row_space.hpp"

namespace gainroom {

// Fills `inverse` L⁻¹ (N, N) of a symmetric A = L Lᵀ, of which the lower triangle is read; false where A is not positive definite.
inline bool inverse_root(const Real& a, Real& inverse) {
    const std::size_t n = a.rows;
    Real root = a;
    for (std::size_t i = 0; i < n; i++) {
        double* row = root.row(i);
        for (std::size_t j = 0; j <= i; j++) {
            const double* other = root.row(j);
            for (std::size_t k = 0; k < j; k++) row[j] -= row[k] * other[k];
            if (j < i)
                row[j] /= other[j];
            else if (!(row[i] > 0))
                return false;
            else
                row[i] = std::sqrt(row[i]);
        }
        double* x = inverse.row(i);  // row i of L⁻¹, from those above
        for (std::size_t j = 0; j < n; j++) x[j] = i == j ? 1.0 : 0.0;
        for (std::size_t k = 0; k < i; k++)
            for (std::size_t j = 0; j <= k; j++) x[j] -= row[k] * inverse.row(k)[j];
        for (std::size_t j = 0; j <= i; j++) x[j] /= row[i];
    }
    return true;
}

// Rᵀ (r, N) with P = R Rᵀ, from L⁻¹ and the held directions J (c, N); rows up to `redundant` of the largest are others' combinations.
inline Real free_motion(const Real& inverse, const Real& held, double redundant) {
    if (!held.rows) return inverse;
    const RowSpace space(product_turned(held, inverse), redundant);
    return product(space.directions(space.rank(), inverse.rows), inverse);
}

struct TaskMotion {
    Real follow, torque;             // Y (N, n), X (n, m)
    std::vector<std::size_t> ranks;  // directions of each task that the joints can move
    std::size_t motions;             // that the contacts leave
};

// tasks   Jacobians (m, N), one below the other, in `sizes` rows each, by falling priority
// movable as MOVABLE in robot/tasks.py
inline TaskMotion task_motion(const Real& inverse, const Real& held, const Real& tasks, const std::vector<std::size_t>& sizes,
                              std::size_t joints, double redundant, double movable) {
    const std::size_t size = inverse.rows;
    const Real motion = free_motion(inverse, held, redundant), turned = transposed(motion);
    const Real moved(joints, motion.rows, turned.row(size - joints));  // M = S R
    const Real back = RowSpace(moved, movable).inverse_turned();       // M⁺ transposed (n, r)
    TaskMotion found{product_turned(turned, back), Real(joints, tasks.rows), {}, motion.rows};
    const Real felt = product(product(tasks, found.follow), moved), alone = product_turned(tasks, inverse);
    Real force(motion.rows, tasks.rows), taken(0, motion.rows);
    std::size_t start = 0;
    for (const std::size_t count : sizes) {
        const Real row(count, motion.rows, felt.row(start));
        const Real shares = product(product_turned(row, taken), taken);
        Real left = row, asked(count, tasks.rows);
        for (std::size_t k = 0; k < left.entries.size(); k++) left.entries[k] -= shares.entries[k];
        const double scale = RowSpace(Real(count, size, alone.row(start)), 0.0).largest();
        const RowSpace reach(left, 0.0, movable * scale);
        const Real done = product(row, force);
        for (std::size_t i = 0; i < count; i++)
            for (std::size_t k = 0; k < tasks.rows; k++) asked.row(i)[k] = (k == start + i ? 1.0 : 0.0) - done.row(i)[k];
        const Real more = product(transposed(reach.inverse_turned()), asked), used = reach.directions(0, reach.rank());
        for (std::size_t k = 0; k < force.entries.size(); k++) force.entries[k] += more.entries[k];
        taken.entries.insert(taken.entries.end(), used.entries.begin(), used.entries.end());
        taken.rows += used.rows;
        found.ranks.push_back(reach.rank());
        start += count;
    }
    found.torque = product(back, force);
    return found;
}

}  // namespace gainroom
