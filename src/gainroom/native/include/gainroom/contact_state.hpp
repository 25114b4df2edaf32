// The tracker's state in one contact state: the crossings at some posture, how far the last count of unstable roots reaches, and the count
// that is under way.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "block.hpp"
#include "counts_below.hpp"
#include "phase_sweep.hpp"

namespace gainroom {

struct ContactState {
    static constexpr std::size_t kSpare = 6;  // crossings followed beside one for each channel
    static constexpr double kNear = 0.15, kLeast = 0.02, kFaster = 3.0;
    static constexpr double kHigh = 10.0, kLowest = 1.1, kBelow = 0.95, kFar = 0.3;
    static constexpr double kNearer = 0.7, kMuchNearer = 0.4;  // of `reach`, see shorten
    static constexpr double kRare = 0.06;   // of the path, after which a crossing that is not the lowest is looked beside again, and
    static constexpr double kStale = 20.0;  // ticks after which one is looked at, however little the robot has moved
    static constexpr double kSearched = 5.0, kShare = 0.4;  // slices; of the room at a tick
    static constexpr double kOften = 3.0;   // counts in the time in which one becomes too old

    ContactState(const TrackedLoop& loop, std::size_t index)
        : number(index), slow_needed(loop.slowest() < loop.lowest()), farthest(loop.farthest()), slowest_speed(loop.slowest_speed()),
          beside(1.0 + loop.beside()), posture(loop.posture_size()), certified_posture(posture) {
        const std::size_t most = loop.channels() + kSpare;
        pool.reserve(most);
        for (std::size_t k = 0; k < most; k++) pool.emplace_back(loop.mode_size());
        for (auto& one : pool) order.push_back(&one);
    }
    ContactState(ContactState&&) = default;

    std::size_t number;
    bool slow_needed;
    double farthest, slowest_speed;  // of `reach`, of crossings
    double beside;                   // up to which factor of the lowest crossing others are looked beside
    Vector<double> posture;  // at which the crossings are
    Vector<TrackedCrossing> pool;
    Vector<TrackedCrossing*> order;  // by rising gain, the first `count` in use
    std::size_t count = 0;
    PhaseSweep sweep;  // the count under way, where `sweeping`
    bool sweeping = false, looking = false;      // looking: a search goes along with it
    bool explaining = false;  // it is over, and found more than known crossings explain: others are looked for where its phase fell,
    std::size_t tried = 0;    // at so many places so far
    // A count that agreed: its factor (0: none), the path at its first slice, whether the slow count held then.
    struct Agreed {
        double factor = 0.0, from = 0.0;
        bool after_slow = false;
    };
    double suspect = 0.0;  // a lower factor at which one found what known crossings do not explain, and is to be confirmed; 0: none
    Agreed kept;           // that one, which holds where it is not
    bool resting = true;                         // counts need be no oftener than the robot moves
    bool sweep_after_slow = false;               // whether the slow count held as it began
    double sweep_from = 0.0, owed = 0.0;       // the path at its first slice; slices that ticks have left over
    double rate = 0.0, length = 40.0;          // of the path, per tick; slices of the last count
    int missed = 0, agreed = 0;  // counts in a row that did not agree, that did
    unsigned vain = 0;           // counts in all that told nothing: the next ones are elsewhere, also where nothing moves
    bool begun = false, searching = false;
    double path = 0.0;                         // how far the robot has moved in all
    long ticks = 0;                            // in this contact state
    int put_off = 0;                           // of these in a row that have not followed all crossings
    double counted = 0.0, counted_from = 0.0;  // the factor of the last count that agreed, the path at its first slice; 0: none
    bool counted_after_slow = false;            // of that count, see `slow_holds`
    CountsBelow below;
    bool goes_below = false;                    // the count under way is one of those
    int since_below = 0;                        // counts since the last one of those
    double unforeseen = 0.0, unforeseen_at = 0.0;  // how fast a crossing has come below the last count, the path at which it was found
    PhaseSweep slow;             // of frequencies below `lowest`, while `slowing`: its factor is high, kHigh times the lowest crossing
    bool slowing = false, loose = false;  // loose: it found that the loop is not stable at low factors
    double slow_from = 0.0, slow_length = 300.0, slow_factor = kHigh;
    double slow_counted = 0.0, slow_counted_from = 0.0;
    double reach = farthest;                     // how far above the lowest crossing the next count may be
    double empty_below = 0.0, seek = 0.5;      // factors without unstable roots, and the next one to look at while none is known
    double certified_gain = 0.0, certified_path = 0.0, certified_speed = 0.0;  // what `remembered` goes from, and
    Vector<double> certified_posture;
    long certified_at = -1;
    double moved = 0.0;  // how far the robot had moved, in all contact states, when `posture` was the robot's

    // How fast a crossing is taken to move at most, in ln g along the path: three times as fast as it has moved lately, unless that is more
    // than any motion can do to it.
    double speed(const TrackedCrossing& one) const { return std::max(slowest_speed, std::min(one.spread, kFaster * one.speed)); }

    // How fast unknown ones have come lately.
    double surprise() const { return unforeseen * std::exp(unforeseen_at - path); }

    // A crossing that the last count did not know has been found at `gain`.
    void surprised(double gain) {
        if (!(gain < counted && path > counted_from)) return;
        unforeseen = std::max(std::log(counted / gain) / (path - counted_from), surprise());
        unforeseen_at = path;
    }

    // Of an unknown one: as the fastest known one up to the factor of the last count. Above it a pair about to merge moves without bound.
    double speed() const {
        double most = std::max(slowest_speed, kFaster * surprise());
        for (std::size_t k = 0; k < count && (k == 0 || order[k]->gain < counted); k++) most = std::max(most, speed(*order[k]));
        return most;
    }

    // What is left of the last certified gain `ahead` of the posture where it was: crossings are taken to move as fast as the fastest one that was
    // known then, times kFaster, but no less than `slowest_speed`: another one may have come nearer. Nothing is left 2 kFar ahead where the loop
    // may be unstable at any factor.
    double remembered(double ahead) const {
        const double speed = std::max(slowest_speed, kFaster * certified_speed);
        return certified_gain * std::exp(-speed * ahead) * (slow_needed ? std::max(0.0, 1.0 - 0.5 * ahead / kFar) : 1.0);
    }

    // The lowest crossing, which is certified in this posture.
    void remember() {
        certified_gain = order[0]->gain;
        certified_path = path;
        std::copy(posture.begin(), posture.end(), certified_posture.begin());
        certified_speed = 0.0;
        for (std::size_t k = 0; k < count; k++) certified_speed = std::max(certified_speed, order[k]->speed);
    }

    // Whether the lowest crossing is known here, with nothing beside it (is_clear) and nothing between it and the factor of a count that still holds;
    // nothing below it has been found otherwise, and nothing crosses slowly.
    bool certified() const {
        if (count == 0 || counted == 0.0) return false;
        const TrackedCrossing& lowest = *order[0];
        return lowest.converged && lowest.seen_at == path && is_clear() && holds(counted, counted_from) && slow_holds() &&
               !is_refuted();
    }

    // Whether something is unstable below the lowest crossing that no known one explains.
    bool is_refuted() const { return pairs(below.found_at()) < below.found(path); }

    // Whether the robot stands where the last count began, and what is below the lowest crossing has not been counted there.
    bool rests_anew() const { return counted_from == path && !below.are_empty(path); }

    // Whether nothing was unstable beside the lowest crossing and those near above it as they were last looked beside.
    bool is_clear() const {
        for (std::size_t k = 0; k < count && is_near(k); k++)
            if (!order[k]->clear) return false;
        return true;
    }
    bool is_near(std::size_t k) const { return !(order[k]->gain > beside * order[0]->gain); }

    // Which crossing is to be looked beside next: the lowest as soon as motion may have changed what was seen there, of the others one that
    // was not clear, or has waited the longest; they are looked beside more rarely, best when they have just been followed. `count`: none.
    std::size_t due() const {
        const TrackedCrossing& lowest = *order[0];
        const bool holds_still = lowest.clear_at == path ? !is_settling(lowest) : path - lowest.clear_at < lowest.clear_for;
        if (!lowest.clear || !lowest.clear_as_lowest || !holds_still) return 0;
        std::size_t found = count;
        for (std::size_t k = 1; k < count && is_near(k); k++) {
            const TrackedCrossing& one = *order[k];
            if (!is_late(one)) continue;
            const TrackedCrossing* before = found < count ? order[found] : nullptr;
            if (!before || one.clear < before->clear || (one.clear == before->clear && one.clear_tick < before->clear_tick)) found = k;
        }
        return found;
    }
    bool is_late(const TrackedCrossing& one) const {
        const double late = one.seen_at == path ? 1.0 : 2.0, way = path - one.clear_at;
        return !one.clear || way > late * kRare || (way > 0.0 ? double(ticks - one.clear_tick) > late * kStale : is_settling(one));
    }
    // Whether the robot has come to rest since a crossing was looked beside with modes that had been followed: once more, with new ones.
    bool is_settling(const TrackedCrossing& one) const { return !one.clear_anew && double(ticks - one.clear_tick) > kStale; }

    // The same of the slow count. The other count must have begun when it held already: else a crossing may have gone from its frequencies to those
    // of the other count between them.
    bool slow_holds() const { return !slow_needed || (counted_after_slow && slow_tells()); }

    // Whether the slow count tells about the lowest crossing here: not beyond kFar of the path, however high its factor was, as crossings may come from
    // infinity and from 0.
    bool slow_tells(double often = 1.0) const {
        return slow_counted > order[0]->gain && often * (path - slow_counted_from) < slow_reach();
    }
    double slow_reach() const { return std::min(std::log(slow_counted / order[0]->gain) / speed(), kFar); }

    // Whether the next slice is one of the slow count: it has become too old, or soon will; elsewhere slices take turns.
    bool slow_turn(bool odd) const {
        if (!slow_needed || count == 0) return false;
        if (!holds(counted, counted_from)) return loose && odd;
        return !slow_tells() || (odd && (slowing || !slow_tells(kOften)));
    }

    // Where something crosses above the lowest crossing only, the next one is below that.
    void conclude_slow(bool done, bool crossed) {
        slowing = false;
        if (done) slow_length = slow.spent();
        if (done && slow.pairs() == 0) {
            loose = false;
            slow_counted = slow.gain();
            slow_counted_from = slow_from;
            slow_factor = std::min(1.15 * slow_factor, kHigh);
            return;
        }
        const double clear = crossed ? kBelow * slow.clear_gain() / order[0]->gain : 0.6 * slow_factor;
        loose = crossed && clear < kLowest;
        if (loose) slow_counted = 0.0;
        slow_factor = std::max(std::min(clear, slow_factor), kLowest);
    }

    // What was counted and looked at tells nothing about the posture of now.
    void doubt() {
        counted = suspect = 0.0;
        sweeping = slowing = false;
        for (std::size_t k = 0; k < count; k++) order[k]->clear = order[k]->has_beside = false;
    }

    // Where the loop is not stable at low factors.
    void loosen() {
        loose = true;
        slowing = false;
        slow_counted = 0.0;
    }

    // Whether a count at `factor`, begun at the path `from`, tells about the lowest crossing here.
    bool holds(double factor, double from) const {
        return factor > order[0]->gain && speed() * (path - from) < std::log(factor / order[0]->gain);
    }

    // Whether a count that has found an unknown crossing below `factor` contradicts the last one that agreed, with the motion since.
    bool refutes(double factor) const { return counted > 0.0 && speed() * (path - counted_from) < std::log(counted / factor); }

    // What there has to be room for before the next slice: a start that a search follows from it costs more than the slice itself.
    double next_cost(double room) const { return sweeping && (looking || explaining) ? std::max(1.0, std::min(kSearched, kShare * room)) : 1.0; }

    Agreed swept() const { return {sweep.gain(), sweep_from, sweep_after_slow}; }

    void agree(const Agreed& one) {
        counted = one.factor;
        counted_from = one.from;
        counted_after_slow = one.after_slow;
        lengthen();
    }

    // Of the count that has just agreed at its own factor but not at the lower one `at`.
    void suspect_at(double at) {
        counted = 0.0;
        searching = count == 0;
        suspect = searching ? 0.0 : at;
        kept = swept();
    }

    // Slices per tick with which counts are kOften times as fast as they become too old.
    double pace() const {
        const double slices = length * speed() / std::log(counted / order[0]->gain);
        return kOften * rate * (slow_needed ? slices + slow_length / slow_reach() : slices);
    }

    // The next count less far above the lowest crossing, but farther than it may come meanwhile.
    void shorten(double share = kNearer) {
        agreed = 0;
        reach = std::max(share * reach, std::min(kLeast + 2.0 * speed() * (path - sweep_from), farthest));
    }

    // After a switch without a certificate: the count under way, where that will tell for as long again; else a new one, near the lowest crossing,
    // where less may be missing. No search yet.
    void hurry() {
        searching = false;
        if (sweeping && !looking && !goes_below && count > 0 && holds(sweep.gain(), sweep_from - (path - sweep_from))) return;
        sweeping = false;
        reach = std::min(reach, kNear);
    }

    void lengthen() {
        missed = 0;
        reach = std::min((agreed++ > 3 ? 1.5 : 1.15) * reach, farthest);
    }

    // Where to count: in the widest gap between known crossings a little above the lowest.
    double next_factor() const {
        if (count == 0) return seek;
        if (suspect > 0.0) return suspect;
        const double lowest = order[0]->gain, end = (1.0 + reach * (1.0 - 0.4 * std::fmod(0.618 * vain, 1.0))) * lowest;
        double from = (1.0 + 0.2 * reach) * lowest, best = 0.0, factor = from;
        for (std::size_t k = 1; k <= count; k++) {
            const double to = k < count ? std::min(order[k]->gain, end) : end;
            if (to > from && to / from > best) {
                best = to / from;
                factor = to == end ? std::pow(from, 0.25) * std::pow(to, 0.75) : std::sqrt(from * to);
            }
            from = std::max(from, to);
        }
        return factor;
    }

    // Pairs of unstable roots at a factor, as the known crossings have it.
    long pairs(double factor) const {
        long sum = 0;
        for (std::size_t k = 0; k < count; k++)
            if (order[k]->gain < factor) sum += order[k]->rising > 0.0 ? 1 : -1;
        return sum;
    }
};

}  // namespace gainroom
