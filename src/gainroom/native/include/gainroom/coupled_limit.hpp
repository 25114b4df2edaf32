// The factor on all gains of coupled joints, on the way from one to another, that first puts a root on the boundary, and the proof that no
// nearer one does.
//
// Each nearer crossing that Newton's method finds (crossing_newton.hpp) brings g nearer; what is excluded up to g (exclusion.hpp) stays excluded
// before it. Where intervals are left that neither tell a crossing nor are excluded, the answer is not decided.
#pragma once

#include "crossing_newton.hpp"
#include "exclusion.hpp"

namespace gainroom {

// Factors on the way from `start`, 0: from rest, to `stop`, which may be less.
struct Way {
    double start, stop;
    bool up() const { return stop > start; }
    // Whether `gain` lies on it, up to `end`.
    bool passes(double gain, double end) const { return up() ? gain > start && gain < end : gain < start && gain > end; }
    bool nearer(double a, double b) const { return up() ? a < b : a > b; }
    // A `share` > 1 further on, < 1 nearer.
    double beyond(double gain, double share) const { return up() ? gain * share : gain / share; }
};

class CoupledLimit : public CrossingNewton {
   public:
    std::vector<Crossing> crossings;  // those found, the nearest first
    std::vector<Interval> undecided;
    double turned = 0.0;  // arg det F where it is excluded, from `low` to `high` of the search, where `counting`
    double tail = 0.0;    // arg det(I + L) where all gains are small from there on, likewise
    double end = 0.0;     // from where on

    using CrossingNewton::CrossingNewton;

    // Before a search from rest up to `highest` on [low, high]: what crossings of a loop much like this one lead to. They only save time.
    void begin(const std::vector<Crossing>& near, double low, double high, double highest) {
        way_ = {0.0, highest};
        for (Crossing one : near)
            if (polish(one) && one.omega >= low && one.omega <= high && one.gain < highest && !known(one)) crossings.push_back(one);
        sort();
    }

    // Searches factors on a way, for [grid.front(), grid.back()], of a plant that is `passive`, or not known to be (Exclusion::not_leading).
    // True where the first of `crossings`, or that there is none, is proved. `bases` (grid_count - 1, n, n): vectors in which to look at the
    // intervals of the grid, see Exclusion; none: the joints.
    bool search(const double* grid, std::size_t grid_count, Way way, double nudge, double floor, bool passive, bool counting = false,
                const Complex* bases = nullptr) {
        if (n_ == 0 || !(std::max(way.start, way.stop) > 0) || grid_count < 2) return false;
        way_ = way;
        counting_ = counting;
        const double low = grid[0], high = grid[grid_count - 1];
        std::vector<Interval> open = within(grid, grid_count, way_end(nudge), passive);
        for (std::size_t k = 0; bases != nullptr && k + 1 < grid_count; k++)
            begin(std::sqrt(grid[k] * grid[k + 1]), bases + k * n_ * n_, low, high);
        for (int round = 0; round < kRounds; round++) {
            const double gain = way_end(nudge);
            undecided = open;
            if (bases != nullptr)
                undecided = left_in_bases(open, gain, floor, grid, grid_count, bases);
            else
                for (const double alignment : {0.0, 1.0}) undecided = left_by(undecided, exclusion(gain, alignment), floor);
            if (undecided.empty()) return true;
            open = undecided;
            if (lowered(gain, low, high) || (crossings.empty() && lowered(gain, low, high, kDense))) continue;
            if (crossings.empty() || bases != nullptr) return false;
            const std::vector<Complex> near = vectors_near();
            undecided = left_by(undecided, exclusion(gain, 0.0, near.data(), near.size() / n_), kFinest);
            if (undecided.empty()) return true;
            open = undecided;
            if (!lowered(gain, low, high) && !lowered(gain, low, high, kDense)) return false;
        }
        return false;
    }

    // Where in [low, high] factors up to `gain` may put a root on the boundary: not where joints lead, nor at the top, where all is small.
    std::vector<Interval> searched(double low, double high, double gain, bool passive) {
        Exclusion ends = exclusion(gain, 0.0);
        end = ends.too_small_from(low, high, counting_ ? &tail : nullptr);
        if (!passive) return {{low, end}};
        std::vector<Interval> left = ends.not_leading(low, end);
        turned += ends.turned;
        return left;
    }

   private:
    static constexpr int kRounds = 24, kStarts = 3, kDense = 129, kSweeps = 12;
    static constexpr double kSame = 1e-7, kNear = 1.5, kFinest = 1e-7;
    static constexpr double kClose = 1.5, kDiagonal = 1e-12, kLeans = 0.5;
    static constexpr std::int64_t kMostNodes = 400;
    static constexpr std::size_t kMost = 6, kFew = 16;  // vectors that are mixed; intervals that are searched densely

    Way way_{0.0, 1.0};
    bool counting_ = false;

    // The part of each interval of a grid that is searched.
    std::vector<Interval> within(const double* grid, std::size_t grid_count, double gain, bool passive) {
        std::vector<Interval> found;
        for (const Interval& among : searched(grid[0], grid[grid_count - 1], gain, passive))
            for (std::size_t k = 1; k < grid_count; k++)
                if (grid[k] > among.low && grid[k - 1] < among.high)
                    found.push_back({std::max(grid[k - 1], among.low), std::min(grid[k], among.high)});
        return found;
    }

    std::vector<Interval> left_by(const std::vector<Interval>& open, Exclusion exclusion, double floor) {
        std::vector<Interval> left;
        const std::int64_t most = kMostNodes + kMostNodes / 8 * static_cast<std::int64_t>(open.size());
        exclusion.run(open, floor, most, left);
        turned += exclusion.turned;
        return left;
    }

    // Crossings that vectors (n, n) lead to in which L is diagonal at ω, from those of its eigenvalues that lie near the negative real axis.
    void begin(double omega, const Complex* vectors, double low, double high) {
        rescale(omega);
        const Way about{way_.beyond(way_.start, 1 / kNear), way_.beyond(way_end(0.0), kNear)};
        for (std::size_t k = 0; k < half_; k++) {
            Crossing one;
            one.omega = omega;
            one.vector.assign(vectors + k * n_, vectors + (k + 1) * n_);
            std::vector<Complex> scaled(n_);
            Complex own = 0.0;
            for (std::size_t i = 0; i < n_; i++) {
                scaled[i] = over(one.vector[i], scale_[i]);
                own += times(times(one.vector[i], one.vector[i]), laws_[i]);
            }
            const Complex v = -over(form(omega, 0.0, scaled), own);
            one.gain = 1 / v.real();
            if (!(std::fabs(v.imag()) < kLeans * v.real()) || !about.passes(one.gain, about.stop)) continue;
            rescale(omega);
            if (polish(one) && one.omega >= low && one.omega <= high && way_.passes(one.gain, way_.stop) && !known(one)) crossings.push_back(one);
            rescale(omega);
        }
        sort();
    }

    std::vector<Interval> left_in_bases(const std::vector<Interval>& open, double gain, double floor, const double* grid,
                                        std::size_t grid_count, const Complex* bases) {
        std::vector<Interval> left;
        for (std::size_t k = 0; k < open.size();) {
            const std::size_t cell = static_cast<std::size_t>(std::upper_bound(grid, grid + grid_count - 1, open[k].low) - grid) - 1;
            std::vector<Interval> inside;
            for (; k < open.size() && open[k].low < grid[cell + 1]; k++) inside.push_back(open[k]);
            const std::vector<Interval> more = left_by(inside, exclusion(gain, 0.0, bases + cell * n_ * n_, n_), floor);
            left.insert(left.end(), more.begin(), more.end());
        }
        return left;
    }

    // Up to where there may be no crossing.
    double way_end(double nudge) const { return crossings.empty() ? way_.stop : way_.beyond(crossings.front().gain, 1 - nudge); }

    Exclusion exclusion(double gain, double alignment, const Complex* near = nullptr, std::size_t count = 0) const {
        return {loop_, way_.up() ? way_.start : gain, way_.up() ? gain : way_.start, alignment, counting_, near, count};
    }

    // Looks for crossings before `gain` from the undecided intervals, first from the likeliest start of each; true where there are. Those a
    // little beyond are kept too: their vectors matter (exclusion.hpp). From so many `points` of each where they are few: a resonance that is
    // damped little tells of itself only nearby.
    bool lowered(double gain, double low, double high, int points = kStarts) {
        if (points > kStarts && undecided.size() > kFew) return false;
        bool found = false;
        for (const bool all : {false, true}) {
            const int first = all ? 0 : points / 2, last = all ? points - 1 : first;
            for (const Interval& interval : undecided)
                for (int k = first; k <= last; k++) {
                    const double omega = interval.low + (interval.high - interval.low) * k / (points - 1);
                    std::vector<Crossing> from = starts(omega, gain, points > kStarts);
                    if (!all && way_.start == 0 && from.size() > 1) from.resize(1);
                    for (Crossing& start : from) {
                        if (!polish(start) || start.omega < low || start.omega > high || known(start)) continue;
                        if (!way_.passes(start.gain, way_.beyond(gain, all && !crossings.empty() ? kNear : 1.0))) continue;
                        found = found || way_.nearer(start.gain, gain);
                        crossings.push_back(start);
                    }
                }
            if (found) break;
        }
        sort();
        return found;
    }

    void sort() { sort(crossings); }

    void sort(std::vector<Crossing>& some) const {
        std::sort(some.begin(), some.end(), [this](const Crossing& a, const Crossing& b) { return way_.nearer(a.gain, b.gain); });
    }

    // Where Re(e^{jθ} F) is singular, e^{jθ} turning the mean of the d_i to be real: of the gains up to 1.5 `gain` those that are nearly the
    // nearest, or `every` one.
    std::vector<Crossing> starts(double omega, double gain, bool every) {
        rescale(omega);
        respond(omega);
        Complex mean = 0.0;
        loop_.inverse_laws(omega, laws_.data());
        for (std::size_t i = 0; i < n_; i++) mean += laws_[i] * (scale_[i] * scale_[i]);
        const Complex turn = std::conj(mean) / std::abs(mean);
        std::vector<double> form(n_ * n_), vectors(n_ * n_, 0.0), units(n_);
        for (std::size_t i = 0; i < n_; i++) {
            const double own = times(turn, laws_[i]).real();
            if (!(own > 0)) return {};
            units[i] = 1 / std::sqrt(own);
            vectors[i * n_ + i] = 1.0;
        }
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j <= i; j++)
                form[i * n_ + j] = form[j * n_ + i] = -times(turn, mobility_[i * n_ + j]).real() * units[i] * units[j];
        diagonalize(form, vectors);
        std::vector<Crossing> found;
        for (std::size_t k = 0; k < n_; k++) {
            const double v = form[k * n_ + k];
            if (!(v > 0) || !Way{way_.beyond(way_.start, 1 / kNear), way_.stop}.passes(1 / v, way_.beyond(gain, kNear))) continue;
            Crossing one;
            one.omega = omega;
            one.gain = 1 / v;
            for (std::size_t i = 0; i < n_; i++) one.vector.push_back(vectors[i * n_ + k] * units[i]);
            found.push_back(one);
        }
        sort(found);
        // From rest the nearest are the largest loci; on from elsewhere those may be others, which do not cross.
        if (every || way_.start != 0) return found;
        while (!found.empty() && !way_.nearer(found.back().gain, way_.beyond(found.front().gain, kClose))) found.pop_back();
        return found;
    }

    // A symmetric matrix by Jacobi's rotations, in place; columns of `vectors` turn with it.
    void diagonalize(std::vector<double>& a, std::vector<double>& vectors) const {
        for (int sweep = 0; sweep < kSweeps; sweep++) {
            double off = 0.0, on = 0.0;
            for (std::size_t p = 0; p < n_; p++)
                for (std::size_t q = 0; q < n_; q++) (p == q ? on : off) += a[p * n_ + q] * a[p * n_ + q];
            if (!(off > kDiagonal * on)) return;
            for (std::size_t p = 0; p < n_; p++)
                for (std::size_t q = p + 1; q < n_; q++) {
                    const double across = a[p * n_ + q];
                    if (across == 0) continue;
                    const double ratio = (a[q * n_ + q] - a[p * n_ + p]) / (2 * across);
                    const double t = (ratio >= 0 ? 1.0 : -1.0) / (std::fabs(ratio) + std::sqrt(ratio * ratio + 1));
                    const double c = 1 / std::sqrt(t * t + 1), s = t * c;
                    for (std::size_t k = 0; k < n_; k++) {
                        const double one = a[k * n_ + p], two = a[k * n_ + q];
                        a[k * n_ + p] = c * one - s * two;
                        a[k * n_ + q] = s * one + c * two;
                    }
                    for (std::size_t k = 0; k < n_; k++) {
                        const double one = a[p * n_ + k], two = a[q * n_ + k];
                        a[p * n_ + k] = c * one - s * two;
                        a[q * n_ + k] = s * one + c * two;
                    }
                    for (std::size_t k = 0; k < n_; k++) {
                        const double one = vectors[k * n_ + p], two = vectors[k * n_ + q];
                        vectors[k * n_ + p] = c * one - s * two;
                        vectors[k * n_ + q] = s * one + c * two;
                    }
                }
        }
    }

    bool known(const Crossing& one) const {
        return std::any_of(crossings.begin(), crossings.end(), [&](const Crossing& other) {
            return std::fabs(one.gain / other.gain - 1) < kSame && std::fabs(one.omega / other.omega - 1) < kSame;
        });
    }

    std::vector<Complex> vectors_near() const {
        std::vector<Complex> found;
        for (const Crossing& one : crossings)
            if (way_.nearer(one.gain, way_.beyond(crossings.front().gain, kNear)) && found.size() < kMost * n_)
                found.insert(found.end(), one.vector.begin(), one.vector.end());
        return found;
    }
};

}  // namespace gainroom
