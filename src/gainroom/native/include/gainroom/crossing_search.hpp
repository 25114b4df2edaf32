// Crossings that are not known yet, looked for along a count: joint_search.hpp and task_search.hpp say where.
#pragma once

#include <cmath>
#include <cstddef>

#include "block.hpp"
#include "crossing_set.hpp"

namespace gainroom {

class CrossingSearch {
public:
    explicit CrossingSearch(CrossingSet& known) : known_(known), trial_(known.loop().mode_size()) {}
    virtual ~CrossingSearch() = default;

    // At the first slice of a count that is searched along; what it cost.
    virtual double begin(ContactState& state) = 0;
    // At one slice of the count, where the loop's `phase` was last; what it cost.
    virtual double look(ContactState& state) = 0;
    // After a count, at a frequency where its phase fell; what it cost.
    virtual double look_at(ContactState& state, double omega) = 0;

protected:
    static constexpr double kBeyond = 1.5;  // of the factor of a count: what is kept

    // Follows trial_ to a crossing, and keeps it where it is one of its own.
    void take(ContactState& state, double& work) {
        if (!known_.loop().follow(state.posture.data(), trial_, 8, work, false)) return;
        if (!(trial_.gain > 0.0 && trial_.gain < kBeyond * state.sweep.gain())) return;
        if (!(trial_.omega > known_.loop().lowest() && trial_.omega < state.sweep.top())) return;
        trial_.seen_at = state.path;
        trial_.speed = 0.0;  // not known: as the others
        for (std::size_t k = 0; k < state.count; k++) trial_.speed = std::max(trial_.speed, state.order[k]->speed);
        for (std::size_t k = 0; k < state.count; k++)
            if (known_.doubles(state, *state.order[k], trial_, work)) return;
        if (!independent(state)) return;
        state.surprised(trial_.gain);
        known_.keep(state, trial_);
    }

    CrossingSet& known_;
    TrackedCrossing trial_;

private:
    static constexpr double kCluster = 1e-3, kDependent = 0.01;  // of crossings that are alike

    void subtract_share(const Vector<Complex>& known) {
        const Complex share = CrossingSet::product(known, trial_.mode);
        for (std::size_t i = 0; i < known.size(); i++) trial_.mode[i] -= times(share, known[i]);
    }

    // Whether trial_'s mode is no combination of those of the known crossings at its place: equal joints that contacts hold have equal
    // crossings, as many as there are directions. It is made orthogonal to them on the way, which leaves it a mode of the same crossing.
    bool independent(const ContactState& state) {
        for (int pass = 0; pass < 3; pass++) {
            for (std::size_t k = 0; k < state.count; k++) {
                const TrackedCrossing& known = *state.order[k];
                if (std::fabs(known.gain - trial_.gain) < kCluster * trial_.gain && std::fabs(known.omega - trial_.omega) < kCluster * trial_.omega &&
                    known.rising * trial_.rising > 0.0)
                    subtract_share(known.mode);
            }
            double left = 0.0;
            for (const Complex& x : trial_.mode) left += std::norm(x);
            if (!(left > kDependent)) return false;
            left = 1.0 / std::sqrt(left);
            for (Complex& x : trial_.mode) x *= left;
        }
        return true;
    }
};

}  // namespace gainroom
