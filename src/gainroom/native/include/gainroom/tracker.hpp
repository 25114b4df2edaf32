// The largest stable common factor on all gains, tick by tick, as the posture moves: GainTracker's core (docs/realtime.md).
//
// Known crossings are followed: at every tick the lowest, every other one that might have come below it, and a tenth of the rest in turn. Meanwhile
// the unstable roots are counted, a few slices per tick, at a factor above the lowest crossing: where the count is that of the known
// crossings below, nothing unknown lies in between. What has been counted holds for as long as the robot has not moved far
// enough to bring an unknown crossing from above that factor below the tracked gain. Where the count differs, slices become
// starts of a search. Restarts (contact switches, jumps of posture) move W in bounded strides from where the crossings were last known.
//
// All space is taken at construction; no exceptions, no allocation in update. For one thread at a time.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "contact_state.hpp"
#include "link_inertia.hpp"
#include "mode_basis.hpp"
#include "phase_sweep.hpp"
#include "posture_change.hpp"

namespace gainroom {

struct TrackerSettings {
    double slices = 0.0;       // of the count at an ordinary tick, and
    double urgent = 0.0;       // where there is no certificate, searches included; 0: as fits a tick, see kSlices
    double stride = 0.3;       // of W at a time after a jump, relative to W + 1/J
    double highest = 1e3;      // factors that are looked for
};

enum class Flag { fine = 0, bad_posture = 1, bad_contact = 2 };

// gain, frequency [rad/s]  of the lowest known crossing; NaN: none known
// certified                the gain is the loop's limit, see docs/realtime.md
// age                      ticks since this contact state's gain was certified; −1: never
// safe_gain                not above gain; of the last certified one where this is not; 0: nothing is known
struct Limit {
    double gain = std::numeric_limits<double>::quiet_NaN(), frequency = std::numeric_limits<double>::quiet_NaN();
    bool certified = false;
    long age = -1;
    double safe_gain = 0.0;
    Flag flag = Flag::fine;
};

class Tracker {
public:
    static constexpr double kSlices = 600.0;  // over n²: with 12 joints 4 slices, which is 5 µs
    static constexpr double kCertain = 1e-6;  // of the gain that safe_gain stays below it

    Tracker(const JointData* joints, std::size_t count, double sample_time, std::size_t contacts, const TrackerSettings& settings = {})
        : laws_(joints, count, sample_time), settings_(settings), solver_(laws_), sweep_(laws_), basis_(laws_), trial_(count), change_(count),
          loci_(count), loci_before_(count) {
        for (std::size_t k = 0; k < contacts; k++) states_.emplace_back(count);
        passive_end_ = laws_.passive_end();
        const double square = double(count * count);
        if (!(settings_.slices > 0.0)) settings_.slices = std::max(kSlices / square, 1.5);
        if (!(settings_.urgent > 0.0)) settings_.urgent = std::max(5.0 * kSlices / square, 6.0);
    }
    Tracker(const Tracker&) = delete;  // parts refer to each other
    const JointLaws& laws() const { return laws_; }
    // Below this frequency [rad/s] every joint's controller only takes energy out; 0: there is none, and the tracker has no start.
    double passive_frequency() const { return passive_end_; }
    std::size_t contacts() const { return states_.size(); }
    std::size_t slices() const { return last_slices_; }
    std::size_t crossings(std::size_t contact) const { return states_[contact].count; }
    const TrackedCrossing& crossing(std::size_t contact, std::size_t k) const { return *states_[contact].order[k]; }
    long pairs() const { return sweep_.pairs(); }
    double counted_gain(std::size_t contact) const { return states_[contact].counted; }

    // One tick: `w` W (n, n), symmetric, in contact state `contact`.
    Limit update(const double* w, std::size_t contact) {
        tick_++;
        if (contact >= states_.size()) return without_evidence(Flag::bad_contact);
        State& state = states_[contact];
        if (!sound(w)) return without_evidence(Flag::bad_posture);
        const double far = state.begun ? change_(laws_, state.w.data(), w) : 0.0;
        if (!std::isfinite(far)) return without_evidence(Flag::bad_posture);
        if (contact != contact_) sweeping_ = false;
        contact_ = contact;
        work_ = 0.0;
        const bool arrived = approach(w, state, far);
        if (arrived) count(state);
        return answer(state, arrived);
    }

    // The answer where nothing is known of this tick: the lowest that was last certified in any contact state.
    Limit without_evidence(Flag flag) const {
        Limit limit;
        limit.flag = flag;
        double lowest = std::numeric_limits<double>::infinity();
        for (const State& state : states_)
            if (state.certified_at >= 0) lowest = std::min(lowest, kShrunk * state.certified_gain);
        limit.safe_gain = std::isfinite(lowest) ? lowest : 0.0;
        return limit;
    }

private:
    static constexpr std::size_t kTurn = 10;  // every one of them is, in so many ticks
    using State = ContactState;
    static constexpr double kShrunk = 0.9, kFollowed = 1.7, kForgets = 0.95;            // see answer, arrange, moved
    static constexpr double kDouble = 1e-5, kCluster = 1e-3, kDependent = 0.01, kNear = 0.05;  // of crossings that are alike
    static constexpr double kBeyond = 1.5;                                              // of the factor of a count: what a search keeps

    // Numbers whose squares are numbers.
    bool sound(const double* w) const {
        double sum = 0.0;
        const std::size_t n = laws_.size();
        for (std::size_t k = 0; k < n * n; k++) sum += std::fabs(w[k]);
        return sum < 1e100;
    }

    // Crossings from where they were to `w`; false where this takes further ticks.
    bool approach(const double* w, State& state, double far) {
        const std::size_t entries = state.w.size();
        if (!state.begun) {
            std::copy(w, w + entries, state.w.begin());
            state.begun = true;
            return true;
        }
        for (int k = 0; k == 0 || work_ < settings_.urgent; k++) {
            if (k > 0) far = change_(laws_, state.w.data(), w);
            if (!(far > settings_.stride)) {
                state.path += far;
                std::copy(w, w + entries, state.w.begin());
                follow(state, k > 0);
                return true;
            }
            sweeping_ = false;
            const double share = std::min(0.5, settings_.stride / far);
            for (std::size_t m = 0; m < entries; m++) state.w[m] += share * (w[m] - state.w[m]);
            state.path += share * far;
            follow(state, true);
        }
        return false;
    }

    void follow(State& state, bool all) {
        state.turn++;
        for (std::size_t k = 0; k < state.count; k++) {
            TrackedCrossing& one = *state.order[k];
            const double drift = State::speed(one) * (state.path - one.seen_at);
            const bool may_be_lowest = k == 0 || one.gain * (1.0 - drift) < state.order[0]->gain;
            if (!all && !may_be_lowest && (state.turn + k) % kTurn != 0) continue;
            if (!moved(state, one)) drop(state, k--);
        }
        arrange(state);
    }

    bool moved(State& state, TrackedCrossing& one) {
        const double before = one.gain;
        CrossingFollower::predict(one, state.path - one.seen_at);
        bool found = solver_.follow(state.w.data(), one, 6, work_);
        if (!found) {
            one.factored = false;
            one.stride = 0.0;
            found = solver_.follow(state.w.data(), one, 8, work_);
        }
        if (const double ahead = state.path - one.seen_at; ahead > 1e-9)
            one.speed = std::max(std::fabs(std::log(one.gain / before)) / ahead, kForgets * one.speed);
        one.seen_at = state.path;
        return found && one.gain > 0.0 && one.omega > passive_end_ && one.omega < highest_omega();
    }

    double highest_omega() const { return laws_.sample_time() > 0.0 ? kPi / laws_.sample_time() : 1e9; }

    void drop(State& state, std::size_t k) {
        if (state.order[k]->gain < state.counted) state.counted = 0.0;  // the count relied on it
        std::rotate(state.order.begin() + long(k), state.order.begin() + long(k) + 1, state.order.begin() + long(state.count));
        state.count--;
    }

    // By rising gain, without doubles and without those far above the lowest.
    void arrange(State& state) {
        const auto first = state.order.begin();
        for (std::size_t i = 1; i < state.count; i++)
            for (std::size_t j = i; j > 0 && state.order[j]->gain < state.order[j - 1]->gain; j--) std::swap(first[long(j)], first[long(j - 1)]);
        for (std::size_t k = 0; k < state.count; k++) {
            if (state.order[k]->seen_at != state.path) continue;  // nothing new about it
            for (std::size_t m = 0; m < state.count; m++)
                if (m != k && doubles(state, *state.order[m], *state.order[k])) {
                    drop(state, std::max(k, m));
                    if (m < k) k--;
                    break;
                }
        }
        while (state.count > 1 && state.order[state.count - 1]->gain > kFollowed * state.order[0]->gain) state.count--;
    }

    // Whether two crossings have become one; where they look alike, the one that was not followed at this tick is.
    bool doubles(State& state, TrackedCrossing& old, TrackedCrossing& now) {
        if (std::fabs(old.gain - now.gain) > 0.02 * now.gain || std::fabs(old.omega - now.omega) > 0.02 * now.omega) return false;
        if (std::norm(product(old.mode, now.mode)) < 0.5) return false;
        if (old.seen_at != state.path && !moved(state, old)) return true;
        return same(old, now);
    }

    static bool same(const TrackedCrossing& a, const TrackedCrossing& b) {
        return std::fabs(a.gain - b.gain) < kDouble * a.gain && std::fabs(a.omega - b.omega) < kDouble * a.omega && std::norm(product(a.mode, b.mode)) > 0.99;
    }

    static Complex product(const std::vector<Complex>& a, const std::vector<Complex>& b) {
        Complex sum = 0.0;
        for (std::size_t i = 0; i < a.size(); i++) sum += times(std::conj(a[i]), b[i]);
        return sum;
    }

    // trial_'s mode without those of known crossings about its frequency; elsewhere the same mode may cross again.
    bool away(const State& state) {
        for (std::size_t k = 0; k < state.count; k++)
            if (std::fabs(state.order[k]->omega - trial_.omega) < kNear * trial_.omega) subtract_share(state.order[k]->mode);
        return CrossingFollower::normalize(trial_.mode);
    }

    void subtract_share(const std::vector<Complex>& known) {
        const Complex share = product(known, trial_.mode);
        for (std::size_t i = 0; i < known.size(); i++) trial_.mode[i] -= times(share, known[i]);
    }

    // Whether trial_'s mode is no combination of those of the known crossings at its place: equal joints that contacts hold have equal
    // crossings, as many as there are directions. It is made orthogonal to them on the way, which leaves it a mode of the same crossing.
    bool independent(const State& state) {
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

    // Slices of the count, as many as this tick has room for.
    void count(State& state) {
        const double room = state.certified() ? settings_.slices : std::max(settings_.urgent - work_, settings_.slices);
        owed_ = std::min(owed_ + room, std::max(room, 1.0));
        double spent = 0.0;
        while (spent + 1.0 <= owed_) {
            if (!sweeping_) {
                if (state.searching && !(state.based_at > state.path - 0.5 * settings_.stride)) {
                    basis_.begin(state.w.data());
                    for (State& other : states_) other.based_at = -1e300;
                    state.based_at = state.path;
                }
                sweep_from_ = state.path;
                sweeping_ = sweep_.begin(state.w.data(), state.next_factor(), passive_end_) == PhaseSweep::State::running;
                spent += 1.0;
                continue;
            }
            const PhaseSweep::State now = sweep_.advance(state.w.data());
            spent += 1.0;
            if (state.searching) spent += search(state);
            if (now == PhaseSweep::State::running) continue;
            sweeping_ = false;
            last_slices_ = sweep_.slices();
            conclude(state, now == PhaseSweep::State::done, sweep_.gain());
        }
        owed_ -= spent;
    }

    // Crossings that are not known yet, from one slice of the count; what it cost.
    double search(State& state) {
        double work = 0.5;
        if (!basis_.ready()) {
            for (int k = 0; k < 3 && !basis_.ready(); k++) basis_.rotate();
            looked_at_ = 0.0;
            return work;
        }
        const double from = looked_at_, omega = sweep_.omega();
        if (!(omega > from)) {  // a new count; or a step that was shortened
            if (omega < from) looked_at_ = 0.0;
            return work;
        }
        looked_at_ = omega;
        loci_before_.swap(loci_);
        basis_.loci(sweep_.values(), sweep_.gain(), loci_.data());
        for (std::size_t k = 0; from > 0.0 && k < loci_.size(); k++) {
            const Complex a = loci_before_[k], b = loci_[k];
            if (!(a.imag() * b.imag() <= 0.0)) continue;
            const double share = a.imag() == b.imag() ? 0.5 : a.imag() / (a.imag() - b.imag()), gain = a.real() + share * (b.real() - a.real());
            if (!(gain > 0.0 && gain < kBeyond * sweep_.gain())) continue;
            solver_.begin(from + share * (omega - from), gain, trial_);
            basis_.mode(k, trial_.mode.data());
            if (CrossingFollower::normalize(trial_.mode) && !resembles_known(state)) take_trial(state, work);
        }
        if (state.tries++ % 3 > 0) return work;
        // A random direction: here, or beside a known crossing, as equal limbs have theirs close together.
        const TrackedCrossing* known = state.tries % 2 == 0 && state.count > 0 ? state.order[state.tries / 2 % state.count] : nullptr;
        if (known && !known->factored) known = nullptr;
        solver_.begin(known ? known->omega : omega, known ? 1.001 * known->gain : sweep_.gain(), trial_);
        for (int pass = 0; pass < 3; pass++) {
            work += 0.5;
            if (!away(state) || !CrossingFollower::sharpen(known ? known->factor : sweep_.factor(), trial_)) return work;
        }
        if (away(state)) take_trial(state, work);
        return work;
    }

    // Whether trial_, a start, looks like a crossing that is known already.
    bool resembles_known(const State& state) const {
        for (std::size_t k = 0; k < state.count; k++) {
            const TrackedCrossing& known = *state.order[k];
            if (std::fabs(known.gain - trial_.gain) < kNear * trial_.gain && std::fabs(known.omega - trial_.omega) < kNear * trial_.omega &&
                std::norm(product(known.mode, trial_.mode)) > 0.6)
                return true;
        }
        return false;
    }

    // Follows trial_ to a crossing, and keeps it where it is one of its own.
    void take_trial(State& state, double& work) {
        if (!solver_.follow(state.w.data(), trial_, 12, work)) return;
        if (!(trial_.gain > 0.0 && trial_.gain < kBeyond * sweep_.gain() && trial_.omega > passive_end_ && trial_.omega < sweep_.top())) return;
        trial_.seen_at = state.path;
        trial_.speed = 0.0;  // not known: as the others
        for (std::size_t k = 0; k < state.count; k++) trial_.speed = std::max(trial_.speed, state.order[k]->speed);
        for (std::size_t k = 0; k < state.count; k++)
            if (doubles(state, *state.order[k], trial_)) return;
        if (!independent(state)) return;
        if (trial_.gain < state.counted) state.counted = 0.0;  // the count did not know it
        if (state.count == state.order.size()) {
            if (trial_.gain > state.order.back()->gain) return;
            state.count--;
        }
        std::swap(trial_, *state.order[state.count++]);
        arrange(state);
    }

    void conclude(State& state, bool done, double factor) {
        if (!done || sweep_.pairs() != state.pairs(factor)) state.vain++;
        if (!done) {
            state.searching = true;
            state.shorten(sweep_from_);
            if (state.count == 0) state.seek *= 0.9;
            return;
        }
        const long expected = state.pairs(factor);
        if (sweep_.pairs() == expected) {
            state.searching = false;
            state.lengthen();
            state.counted = factor;
            state.counted_from = sweep_from_;
            state.empty_below = expected == 0 ? factor : 0.0;
            if (state.count == 0) state.seek = std::min(1.5 * factor, settings_.highest);
            return;
        }
        if (sweep_.pairs() < expected && state.count > 0) state.count = 1;  // some account for each other: all but the lowest are found anew
        state.searching = ++state.missed > 1 || !state.certified();  // nearer to the lowest crossing nothing may be missing
        state.shorten(sweep_from_);
        if (state.count > 0) return;
        // No crossing known: nearer to where there are no unstable roots, and a search where that is near.
        state.searching = state.empty_below > 0.0 && factor < 1.2 * state.empty_below;
        state.seek = state.empty_below > 0.0 ? std::sqrt(state.empty_below * factor) : 0.5 * factor;
        if (state.searching) state.seek = factor;
    }

    Limit answer(State& state, bool arrived) {
        Limit limit;
        if (state.count > 0) {
            limit.gain = state.order[0]->gain;
            limit.frequency = state.order[0]->omega;
        }
        limit.certified = arrived && state.certified();
        if (limit.certified) {
            state.certify(limit.gain, tick_);
            limit.safe_gain = (1.0 - kCertain) * limit.gain;
        } else if (state.certified_at >= 0) {
            limit.safe_gain = kShrunk * state.remembered();
        } else {
            limit.safe_gain = without_evidence(Flag::fine).safe_gain;
        }
        if (state.count > 0) limit.safe_gain = std::min(limit.safe_gain, (1.0 - kCertain) * limit.gain);
        limit.age = state.certified_at < 0 ? -1 : tick_ - state.certified_at;
        return limit;
    }

    JointLaws laws_;
    TrackerSettings settings_;
    CrossingFollower solver_;
    PhaseSweep sweep_;
    ModeBasis basis_;
    TrackedCrossing trial_;
    PostureChange change_;
    std::vector<Complex> loci_, loci_before_;
    double looked_at_ = 0.0;
    std::vector<State> states_;
    std::size_t contact_ = std::size_t(-1), last_slices_ = 0;
    bool sweeping_ = false;
    double passive_end_ = 0.0, sweep_from_ = 0.0, owed_ = 0.0, work_ = 0.0;
    long tick_ = 0;
};

}  // namespace gainroom
