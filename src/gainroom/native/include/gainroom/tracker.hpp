// The largest stable common factor on all gains, tick by tick, as the posture moves: GainTracker's core (docs/realtime.md).
//
// Known crossings are followed (crossing_set.hpp). Meanwhile the unstable roots are counted, a few slices per tick, at a factor above the lowest
// crossing: where the count is that of the known crossings below, nothing unknown lies in between. What has been counted holds for as long
// as the robot has not moved far enough to bring an unknown crossing from above that factor below the tracked gain; counts follow each other
// three times as fast. Where it finds more, its slices at which the phase fell are starts of a search, then all slices of the next count
// (crossing_search.hpp). Restarts (jumps of posture,
// contact states that were not prepared) move the posture in bounded strides from where the crossings were last known.
//
// All space is taken at construction; no exceptions, no allocation in update. For one thread at a time.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "block.hpp"
#include "contact_state.hpp"
#include "crossing_search.hpp"
#include "crossing_set.hpp"
#include "four.hpp"

namespace gainroom {

struct TrackerSettings {
    double slices = 0.0;       // of the count at an ordinary tick, and
    double urgent = 0.0;       // where there is no certificate, searches included; 0: as fits a tick, see kSlices
    double stride = 0.3;       // of the posture at a time after a jump, as the loop's `distance` has it
    double highest = 1e3;      // factors that are looked for
};

enum class Flag { fine = 0, bad_posture = 1, bad_contact = 2, too_few_constraints = 3, not_settled = 4 };

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
    static constexpr double kCertain = 1e-6;  // of the gain that safe_gain stays below it
    static constexpr double kShrunk = 0.9;    // of what was certified, or computed in another posture

    Tracker(CrossingSet& known, CrossingSearch& search, std::size_t contacts, const TrackerSettings& settings)
        : settings_(settings), loop_(known.loop()), known_(known), search_(search) {
        states_.reserve(contacts);
        for (std::size_t k = 0; k < contacts; k++) states_.emplace_back(loop_, k);
        prepared_ = settings_.slices > 0.0 ? 3.0 * settings_.slices : loop_.prepared_slices();
        if (!(settings_.slices > 0.0)) settings_.slices = loop_.usual_slices();
        if (!(settings_.urgent > 0.0)) settings_.urgent = loop_.urgent_slices();
    }
    // Below this frequency [rad/s] nothing crosses; 0: that is not known of any, and the tracker has no start.
    double passive_frequency() const { return loop_.lowest(); }
    std::size_t contacts() const { return states_.size(); }
    std::size_t crossings(std::size_t contact) const { return states_[contact].count; }
    const TrackedCrossing& crossing(std::size_t contact, std::size_t k) const { return *states_[contact].order[k]; }
    double counted_gain(std::size_t contact) const { return states_[contact].counted; }

    // One tick at a posture (posture_size of the loop) in contact state `contact`.
    Limit update(const double* posture, std::size_t contact) {
        if (contact >= states_.size()) return lost(Flag::bad_contact);
        State& state = states_[contact];
        const double far = sound(posture) ? known_.distance(state, posture) : std::numeric_limits<double>::quiet_NaN();
        if (!std::isfinite(far)) return lost(Flag::bad_posture, contact);
        tick_++;
        moved_ += contact == contact_ ? far : last_rate();
        work_ = 0.0;
        const bool arrived = known_.approach(posture, state, far, settings_.urgent, contact != contact_, work_);
        state.rate = std::max(far, kForgets * state.rate);
        state.moved = moved_;
        if (arrived) {
            if (contact != contact_ && !state.certified()) state.hurry();
            contact_ = contact;
            const double room = room_for(state);
            work_ += room;
            count(state, room);
            if (state.slow_needed && state.count > 0 && !loop_.leads_slowly(state.posture.data(), state.order[0]->gain)) state.loosen();
        }
        return answer(state, posture, arrived);
    }

    // How much of the work that a tick may have the last one had: above kBusy there is no time for `prepare`.
    double load() const { return work_ / settings_.urgent; }
    static constexpr double kBusy = 0.75;

    // Brings what is known of another contact state near to where it will be needed: this tick's posture, were the robot in `contact`.
    void prepare(const double* posture, std::size_t contact) {
        if (contact >= states_.size() || !sound(posture)) return;
        State& state = states_[contact];
        const double far = known_.distance(state, posture);
        const double room = std::min(prepared_, settings_.urgent - work_);
        double work = 0.0;
        if (!std::isfinite(far) || !known_.draw_near(posture, state, far, 0.6 * room, work)) return;
        count(state, room - work);
        state.moved = moved_;
        if (state.certified_at >= 0 && state.certified()) state.remember();
    }

    // The answer to a tick of which nothing is known, or its contact state alone: what is left of what was certified there, or the least of all
    // contact states, were the robot to move on as fast as it did; and no more than the last answer, nor than is left of `limit`, a limit in another
    // posture.
    Limit lost(Flag flag, std::size_t contact = std::size_t(-1), double limit = std::numeric_limits<double>::infinity()) {
        tick_++;
        moved_ += last_rate();
        Limit answer;
        answer.flag = flag;
        answered_ = std::min({answered_, kShrunk * limit, contact < states_.size() ? remembered(states_[contact]) : least_remembered()});
        answer.safe_gain = answered_;
        return answer;
    }

private:
    using State = ContactState;
    static constexpr double kForgets = 0.95;                 // of the rate, per tick
    static constexpr double kOneSided = 0.7, kUneven = 0.2;  // gains that are counted closer, and as often as there is time
    static constexpr double kBeside = 0.1;                   // of a factor
    static constexpr int kFirst = 4;                         // counts above the lowest crossing before one below it
    static constexpr int kSuspected = 4;                     // counts at one factor
    static constexpr double kIdle = 0.5, kStill = 0.05;      // slices where nothing moves, or next to nothing

    // Of the path, per tick, in the contact state of the last ones.
    double last_rate() const { return contact_ < states_.size() ? states_[contact_].rate : 0.0; }

    // What is left in the posture `now` of what was certified in a contact state: along the path, `left` farther than the state's crossings have been
    // followed, or straight from where that was, as far as the logarithm of W tells, where that is shorter and nothing crosses slowly; and `unseen` farther.
    double remembered(const State& state, const double* now, double left, double unseen) {
        if (state.certified_at < 0 || state.loose) return 0.0;
        const double *before = state.certified_posture.data(), along = state.path + left - state.certified_path;
        if (state.slow_needed) return kShrunk * state.remembered(along + unseen);
        const double straight = std::log1p(std::max(loop_.distance(before, now), loop_.distance(now, before)));
        return kShrunk * state.remembered(std::fmin(straight, along) + unseen);  // not finite: along the path
    }
    double remembered(const State& state) { return remembered(state, state.posture.data(), 0.0, moved_ - state.moved); }
    double least_remembered() {
        double least = std::numeric_limits<double>::infinity();
        for (const State& state : states_)
            if (state.certified_at >= 0) least = std::min(least, remembered(state));
        return std::isfinite(least) ? least : 0.0;
    }

    // For slices, at this tick: where there is no certificate, all that is left after `work`, for the nearest count that will give one.
    double room_for(const State& state) const {
        const bool certified = state.certified();
        if (!certified) return std::max(settings_.urgent - work_, settings_.slices);
        const bool idle = state.missed == 0 && state.resting && !state.rests_anew();
        return std::min(std::max(state.pace(), idle ? kIdle : settings_.slices), 0.5 * settings_.urgent);
    }

    // Numbers whose squares are numbers.
    GAINROOM_WIDE bool sound(const double* posture) const {
        return scalar_product(posture, posture, loop_.posture_size()) < 1e200;
    }

    // Slices of the count, as many as there is room for.
    void count(State& state, double room) {
        state.owed = std::min(state.owed + room, std::max(room, 1.0));
        double spent = 0.0;
        while (spent + state.next_cost(room) <= state.owed) {
            spent += 1.0;
            if (state.slow_turn(odd_ = !odd_)) {
                count_slowly(state);
                spent += state.slow.cost() - 1.0;
                continue;
            }
            if (state.sweeping && state.goes_below && !has_time_below(state)) state.sweeping = false;
            if (!state.sweeping) {
                state.goes_below = has_time_below(state) && (!state.goes_below || state.rests_anew());
                const double factor = state.goes_below ? state.below.factor(state.order[0]->gain) : state.next_factor();
                const double one_sided = loop_.one_sided(state.posture.data());
                state.slowest_speed = (one_sided > kOneSided ? State::kFaster : 1.0) * loop_.slowest_speed();
                state.looking = (state.goes_below ? state.is_refuted() : state.searching) || one_sided > kOneSided;
                state.resting = !(one_sided > kUneven);
                state.explaining = false;
                state.sweep_from = state.path;
                state.sweep_after_slow = state.slow_needed && state.count > 0 && state.slow_tells();
                state.sweeping = state.sweep.begin(loop_, state.posture.data(), factor) == PhaseSweep::State::running;
                if (state.sweeping && state.looking) spent += search_.begin(state);
                continue;
            }
            if (state.explaining) {
                spent += explain(state) - 1.0;
                continue;
            }
            const PhaseSweep::State now = state.sweep.advance(loop_, state.posture.data());
            spent += state.sweep.cost() - 1.0;
            if (state.looking) spent += search_.look(state);
            if (now == PhaseSweep::State::running) continue;
            state.sweeping = false;
            const bool done = now == PhaseSweep::State::done;
            state.since_below = state.goes_below ? 0 : state.since_below + 1;
            if (state.goes_below) {
                // A crossing may have come below it meanwhile.
                const bool tells = done && state.count > 0 && !(state.order[0]->gain < state.sweep.gain());
                state.below.conclude(tells, state.sweep.gain(), state.sweep.pairs(), state.sweep_from, state.path);
                continue;
            }
            state.length = state.sweep.spent();
            state.explaining = state.sweeping = done && state.sweep.pairs() > state.pairs(state.sweep.gain());
            state.tried = 0;
            if (!state.explaining) conclude(state, done);
        }
        state.owed -= spent;
    }

    // The count has found more than known crossings explain: a search at one of its falls, until they do or all have been tried; what it cost. Where
    // they do, further ones may still cancel each other in it, but hardly in the next count, which is much nearer to the lowest crossing.
    double explain(State& state) {
        const bool explained = state.sweep.pairs() <= state.pairs(state.sweep.gain());
        if (!explained && state.tried < state.sweep.falls()) return search_.look_at(state, state.sweep.fall(state.tried++));
        state.sweeping = state.explaining = false;
        if (!explained) {
            conclude(state, true);
        } else {
            state.suspect = 0.0;
            state.shorten(State::kMuchNearer);
        }
        return 0.0;
    }

    // Whether there is time for a count below the lowest crossing: in this contact state, where the robot hardly moves, and as long as one has
    // found something there. While those above it do not reach as far as they may, one for every few of them.
    bool has_time_below(const State& state) const {
        if (state.number != contact_ || state.count == 0 || state.counted == 0.0) return false;
        if (state.is_refuted()) return true;
        const bool is_still = state.counted_from == state.path || state.pace() < kStill, first = state.reach < state.farthest;
        return state.certified() && is_still && (!first || state.since_below >= kFirst);
    }

    // One slice below the frequencies that are followed.
    void count_slowly(State& state) {
        PhaseSweep::State now;
        if (!state.slowing) {
            state.slow_from = state.path;
            now = state.slow.begin(loop_, state.posture.data(), state.slow_factor * state.order[0]->gain, true);
            state.slowing = true;
        } else {
            now = state.slow.advance(loop_, state.posture.data());
        }
        if (now != PhaseSweep::State::running) state.conclude_slow(now == PhaseSweep::State::done, now == PhaseSweep::State::crossed);
    }

    void conclude(State& state, bool done) {
        const double factor = state.sweep.gain();
        const long pairs = state.sweep.pairs(), expected = state.pairs(factor);
        const bool agrees = done && pairs == expected;
        if (!agrees) state.vain++;
        if (state.suspect > 0.0) return conclude_suspect(state, agrees);
        if (!done) {
            state.searching = state.missed++ > 0;
            state.shorten();
            if (state.count == 0) state.seek *= 0.9;
            return;
        }
        const double unforeseen = agrees ? unforeseen_below(state) : 0.0;
        if (unforeseen > 0.0) {  // a pair of crossings below the lowest one that is known, or steps that were too long for that factor
            state.suspect_at(unforeseen);
            state.missed++;
            return;
        }
        if (agrees) {
            state.searching = false;
            state.agree(state.swept());
            state.empty_below = expected == 0 ? factor : 0.0;
            if (state.count == 0) state.seek = std::min(1.5 * factor, settings_.highest);
            return;
        }
        if (pairs > expected && state.refutes(factor)) state.counted = 0.0;
        // Some account for each other: all but the lowest are found anew, unless the count is too old to tell.
        if (pairs < expected && state.count > 0 && state.holds(factor, state.sweep_from)) state.count = 1;
        state.searching = ++state.missed > 1 || !state.certified();  // nearer to the lowest crossing nothing may be missing
        state.shorten();
        if (state.count > 0) return;
        // No crossing known: nearer to where there are no unstable roots, and a search where that is near.
        state.searching = state.empty_below > 0.0 && factor < 1.2 * state.empty_below;
        state.seek = state.empty_below > 0.0 ? std::sqrt(state.empty_below * factor) : 0.5 * factor;
        if (state.searching) state.seek = factor;
    }

    // The count at the suspect factor itself: `agrees` where that is none. Else it goes on there, with a search.
    static void conclude_suspect(State& state, bool agrees) {
        state.searching = !agrees;
        if (agrees || ++state.missed > kSuspected) state.suspect = 0.0;
        if (agrees && state.kept.factor > 0.0) state.agree(state.kept);
    }

    // A lower factor at which the count found what known crossings do not explain; 0: none. Those near a crossing, which may have passed them
    // meanwhile, do not count.
    double unforeseen_below(const State& state) const {
        for (std::size_t k = 0; k < state.sweep.lower(); k++) {
            const double factor = state.sweep.lower_gain(k);
            bool near = false;
            for (std::size_t m = 0; m < state.count; m++) near = near || std::fabs(state.order[m]->gain / factor - 1.0) < kBeside;
            const long pairs = state.sweep.lower_pairs(k);
            if (!near && pairs != PhaseSweep::kUnclear && pairs != state.pairs(factor)) return factor;
        }
        return 0.0;
    }

    // At the posture, where the crossings of the state have `arrived`, or on the way to it.
    Limit answer(State& state, const double* posture, bool arrived) {
        Limit limit;
        if (state.count > 0) {
            limit.gain = state.order[0]->gain;
            limit.frequency = state.order[0]->omega;
        }
        limit.certified = arrived && state.certified();
        if (limit.certified) {
            state.remember();
            state.certified_at = tick_;
            limit.safe_gain = (1.0 - kCertain) * limit.gain;
        } else if (state.certified_at >= 0) {
            const double left = arrived ? 0.0 : known_.distance(state, posture);
            limit.safe_gain = remembered(state, posture, left, 0.0);
        } else if (!state.slow_needed) {
            limit.safe_gain = least_remembered();
        }
        if (state.loose) limit.safe_gain = 0.0;
        if (state.count > 0) limit.safe_gain = std::min(limit.safe_gain, (1.0 - kCertain) * limit.gain);
        limit.age = state.certified_at < 0 ? -1 : tick_ - state.certified_at;
        answered_ = limit.safe_gain;
        return limit;
    }

    TrackerSettings settings_;
    TrackedLoop& loop_;
    CrossingSet& known_;
    CrossingSearch& search_;
    Vector<State> states_;
    double prepared_;    // slices for another contact state
    double work_ = 0.0;  // of the last tick
    double moved_ = 0.0;  // how far the robot has moved in all
    double answered_ = std::numeric_limits<double>::infinity();  // the last safe_gain
    std::size_t contact_ = std::size_t(-1);
    long tick_ = 0;
    bool odd_ = false;
};

}  // namespace gainroom
