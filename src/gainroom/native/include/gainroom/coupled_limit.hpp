// The factor on all gains of coupled joints, on the way from one to another, that first puts a root on the boundary, and the proof that no
// nearer one does.
//
// F = Q + v diag(d_i), v = 1/g, is singular where a root crosses (modal_loop.hpp). With a border b, the solution of
//
//   [F b; bᵀ 0] [x; μ] = [0; 1]   has   μ = 0 exactly there, and   dμ = −xᵀ dF x,
//
// as F is complex symmetric: Newton's method in (ω, v) takes one factorisation per step. (Where F is half of a twofold one, the same from
// either side: dμ = −yᵀ dF x.) Each nearer crossing that is found brings g nearer;
// what is excluded up to g (exclusion.hpp) stays excluded before it. Where intervals are left that neither tell a crossing nor are excluded, the
// answer is not decided.
#pragma once

#include "exclusion.hpp"

namespace gainroom {

struct Crossing {
    double omega = 0.0, gain = 0.0;
    double growth = 0.0;  // Re of how the root moves with ln g, over its size: > 0 towards instability
    std::vector<Complex> vector;  // x: torques; positions are x_i/c_i. Twofold: z of exclusion.hpp
};

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

class CoupledLimit {
   public:
    std::vector<Crossing> crossings;  // those found, the nearest first
    std::vector<Interval> undecided;
    double turned = 0.0;  // arg det F where it is excluded, from `low` to `high` of the search, where `counting`
    double tail = 0.0;    // arg det(I + L) where all gains are small from there on, likewise
    double end = 0.0;     // from where on

    explicit CoupledLimit(const ModalLoop& loop) : loop_(loop), n_(loop.size), half_(loop.twofold ? n_ / 2 : n_), border_(half_ + 1) {
        matrix_.resize(border_ * border_);
        solution_.resize(border_);
        functions_.resize(loop.modes);
        later_.resize(loop.modes);
        laws_.resize(n_);
        later_laws_.resize(n_);
        scale_.resize(n_);
        mobility_.resize(n_ * n_);
    }

    // Before a search from rest up to `highest` on [low, high]: what crossings of a loop much like this one lead to. They only save time.
    void begin(const std::vector<Crossing>& near, double low, double high, double highest) {
        way_ = {0.0, highest};
        for (Crossing one : near)
            if (polish(one) && one.omega >= low && one.omega <= high && one.gain < highest && !known(one)) crossings.push_back(one);
        sort();
    }

    // Searches factors on a way, for [grid.front(), grid.back()], of a plant that is `passive`, or not known to be (Exclusion::not_leading).
    // True where the first of `crossings`, or that there is none, is proved.
    bool search(const double* grid, std::size_t grid_count, Way way, double nudge, double floor, bool passive, bool counting = false) {
        if (n_ == 0 || !(std::max(way.start, way.stop) > 0) || grid_count < 2) return false;
        way_ = way;
        counting_ = counting;
        std::vector<Interval> open;
        for (const Interval& among : searched(grid[0], grid[grid_count - 1], way_end(nudge), passive))
            for (std::size_t k = 1; k < grid_count; k++)
                if (grid[k] > among.low && grid[k - 1] < among.high)
                    open.push_back({std::max(grid[k - 1], among.low), std::min(grid[k], among.high)});
        for (int round = 0; round < kRounds; round++) {
            const double gain = way_end(nudge);
            undecided = open;
            for (const double alignment : {0.0, 1.0}) undecided = left_by(undecided, exclusion(gain, alignment), floor);
            if (undecided.empty()) return true;
            open = undecided;
            if (lowered(gain, grid[0], grid[grid_count - 1])) continue;
            if (crossings.empty()) return false;
            const std::vector<Complex> near = vectors_near();
            undecided = left_by(undecided, exclusion(gain, 0.0, near.data(), near.size() / n_), kFinest);
            if (undecided.empty()) return true;
            open = undecided;
            if (!lowered(gain, grid[0], grid[grid_count - 1])) return false;
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

    // From ω, g and x; false where it leads nowhere.
    bool polish(Crossing& at) {
        double omega = at.omega, v = 1 / at.gain;
        std::vector<Complex>& x = at.vector;
        rescale(omega);
        for (std::size_t i = 0; i < n_; i++) x[i] = over(x[i], scale_[i]);
        for (int step = 0; step < kSteps; step++) {
            const double ahead = omega * (1 + kDifference);
            Complex mu, slope_v = 0.0;
            if (!(loop_.twofold ? bordered_twofold(omega, v, x, mu) : bordered(omega, v, x, mu))) return false;
            for (std::size_t i = 0; i < n_; i++) slope_v -= times(times(x[i], x[i]), times(laws_[i], Complex(scale_[i] * scale_[i])));
            const Complex slope_omega = -over(form(ahead, v, x) - form(omega, v, x), Complex(ahead - omega));
            const double determinant = slope_omega.real() * slope_v.imag() - slope_omega.imag() * slope_v.real();
            double step_omega = (mu.real() * slope_v.imag() - mu.imag() * slope_v.real()) / determinant;
            double step_v = (slope_omega.real() * mu.imag() - slope_omega.imag() * mu.real()) / determinant;
            const double far = std::max(std::fabs(step_omega) / (kFar * omega), std::fabs(step_v) / (kFar * v));
            if (!std::isfinite(far)) return false;
            if (far > 1) {
                step_omega /= far;
                step_v /= far;
            }
            omega -= step_omega;
            v -= step_v;
            if (!(omega > 0) || !(v > 0)) return false;
            if (far * kFar < kSettled) {
                at.omega = omega;
                at.gain = 1 / v;
                at.growth = -v * over(times({0.0, -1.0}, slope_v), slope_omega).real() / omega;
                for (std::size_t i = 0; i < n_; i++) x[i] *= scale_[i];
                return true;
            }
        }
        return false;
    }

   private:
    static constexpr int kRounds = 24, kSteps = 24, kStarts = 3, kSweeps = 12;
    static constexpr double kDifference = 1e-6, kFar = 0.3, kSettled = 1e-13, kSame = 1e-7, kNear = 1.5, kFinest = 1e-7;
    static constexpr double kClose = 1.5, kDiagonal = 1e-12;
    static constexpr std::int64_t kMostNodes = 400;
    static constexpr std::size_t kMost = 6;  // vectors that are mixed

    const ModalLoop& loop_;
    Way way_{0.0, 1.0};
    bool counting_ = false;
    std::size_t n_, half_, border_;
    std::vector<Complex> mobility_, matrix_, solution_, functions_, later_, laws_, later_laws_;
    std::vector<double> scale_;

    std::vector<Interval> left_by(const std::vector<Interval>& open, Exclusion exclusion, double floor) {
        std::vector<Interval> left;
        const std::int64_t most = kMostNodes + kMostNodes / 8 * static_cast<std::int64_t>(open.size());
        exclusion.run(open, floor, most, left);
        turned += exclusion.turned;
        return left;
    }

    // Up to where there may be no crossing.
    double way_end(double nudge) const { return crossings.empty() ? way_.stop : way_.beyond(crossings.front().gain, 1 - nudge); }

    Exclusion exclusion(double gain, double alignment, const Complex* near = nullptr, std::size_t count = 0) const {
        return {loop_, way_.up() ? way_.start : gain, way_.up() ? gain : way_.start, alignment, counting_, near, count};
    }

    // Looks for crossings before `gain` from the undecided intervals, first from the likeliest start of each; true where there are. Those a
    // little beyond are kept too: their vectors matter (exclusion.hpp).
    bool lowered(double gain, double low, double high) {
        bool found = false;
        for (const bool all : {false, true}) {
            for (const Interval& interval : undecided)
                for (int k = all ? 0 : 1; k < (all ? kStarts : 2); k++) {
                    std::vector<Crossing> from = starts(interval.low + (interval.high - interval.low) * k / (kStarts - 1), gain);
                    if (!all && from.size() > 1) from.resize(1);
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

    // Where Re(e^{jθ} F) is singular, e^{jθ} turning the mean of the d_i to be real: the gains up to 1.5 `gain` that are nearly the nearest.
    std::vector<Crossing> starts(double omega, double gain) {
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
            {
                found.insert(found.end(), one.vector.begin(), one.vector.end());
                if (!loop_.twofold) continue;
                found.insert(found.end(), one.vector.begin() + half_, one.vector.end());
                for (std::size_t i = 0; i < half_; i++) found.push_back(-one.vector[i]);
            }
        return found;
    }

    void rescale(double omega) {
        loop_.inverse_laws(omega, laws_.data());
        for (std::size_t i = 0; i < n_; i++) scale_[i] = 1 / std::sqrt(std::abs(laws_[i]));
    }

    // Q at ω, lower triangle.
    void respond(double omega) {
        Complex f0;
        loop_.functions(omega, f0, functions_.data());
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j <= i; j++) mobility_[i * n_ + j] = times(loop_.rigid_at(i * n_ + j), f0);
        for (std::size_t k = 0; k < loop_.modes; k++) {
            const Complex* shape = &loop_.shapes[k * n_];
            for (std::size_t i = 0; i < n_; i++) {
                const Complex f = times(functions_[k], shape[i]);
                for (std::size_t j = 0; j <= i; j++) mobility_[i * n_ + j] += times(f, shape[j]);
            }
        }
    }

    // x at (ω, v) from one nearby, in the units of `scale_`; false where there is none.
    bool bordered(double omega, double v, std::vector<Complex>& x, Complex& mu) {
        fill(omega, v);
        if (!border(x, x, false) || !solve()) return false;
        std::copy(solution_.begin(), solution_.end() - 1, x.begin());
        mu = solution_[half_];
        return true;
    }

    // z likewise.
    bool bordered_twofold(double omega, double v, std::vector<Complex>& z, Complex& mu) {
        std::vector<Complex> x(half_), y(half_);
        for (std::size_t i = 0; i < half_; i++) {
            const Complex turned = times({0.0, 1.0}, z[half_ + i]);
            x[i] = z[i] + turned;
            y[i] = z[i] - turned;
        }
        std::vector<Complex> right, left;
        fill(omega, v);
        if (!border(x, y, false) || !solve()) return false;
        right = solution_;
        fill(omega, v);
        if (!border(y, x, true) || !solve()) return false;
        left = solution_;
        mu = right[half_];
        double sizes[2] = {0.0, 0.0};
        for (std::size_t i = 0; i < half_; i++) {
            sizes[0] += std::norm(right[i]);
            sizes[1] += std::norm(left[i]);
        }
        const double balance = std::pow(sizes[0] / sizes[1], 0.25);  // dμ is of their product
        for (std::size_t i = 0; i < half_; i++) {
            const Complex one = right[i] / balance, other = left[i] * balance;
            z[i] = 0.5 * (other + one);
            z[half_ + i] = times({0.0, 0.5}, other - one);
        }
        return true;
    }

    // F (r, r) at (ω, v), or all of it, in the corner of the bordered matrix.
    void fill(double omega, double v) {
        respond(omega);
        loop_.inverse_laws(omega, laws_.data());
        for (std::size_t i = 0; i < half_; i++) {
            for (std::size_t j = 0; j < half_; j++) {
                Complex value = mobility_[std::max(i, j) * n_ + std::min(i, j)];
                if (loop_.twofold) value -= times({0.0, 1.0}, mobility_[(half_ + j) * n_ + i]);
                matrix_[i * border_ + j] = value * (scale_[i] * scale_[j]);
            }
            matrix_[i * border_ + i] += v * laws_[i] * (scale_[i] * scale_[i]);
        }
    }

    // The borders of F, or of Fᵀ: conjugates of `row` below and of `column` beside it; false where these are nothing.
    bool border(const std::vector<Complex>& row, const std::vector<Complex>& column, bool transposed) {
        double sizes[2] = {0.0, 0.0};
        for (std::size_t i = 0; i < half_; i++) {
            sizes[0] += std::norm(row[i]);
            sizes[1] += std::norm(column[i]);
            for (std::size_t j = 0; j < i && transposed; j++) std::swap(matrix_[i * border_ + j], matrix_[j * border_ + i]);
            solution_[i] = 0.0;
        }
        if (!(sizes[0] > 0 && sizes[1] > 0) || !std::isfinite(sizes[0] + sizes[1])) return false;
        for (std::size_t i = 0; i < half_; i++) {
            matrix_[half_ * border_ + i] = std::conj(row[i]) / std::sqrt(sizes[0]);
            matrix_[i * border_ + half_] = std::conj(column[i]) / std::sqrt(sizes[1]);
        }
        matrix_[half_ * border_ + half_] = 0.0;
        solution_[half_] = 1.0;
        return true;
    }

    // xᵀ F x at (ω, v).
    Complex form(double omega, double v, const std::vector<Complex>& x) {
        Complex f0, value = 0.0;
        loop_.functions(omega, f0, later_.data());
        loop_.inverse_laws(omega, later_laws_.data());
        for (std::size_t i = 0; i < n_; i++) {
            const Complex own = x[i] * scale_[i];
            Complex rest = 0.0;
            for (std::size_t j = 0; j < n_; j++) rest += times(loop_.rigid_at(i * n_ + j), scale_[j] * x[j]);
            value += times(own, times(f0, rest) + v * times(later_laws_[i], own));
        }
        for (std::size_t k = 0; k < loop_.modes; k++) {
            Complex along = 0.0;
            for (std::size_t i = 0; i < n_; i++) along += times(loop_.shapes[k * n_ + i], x[i] * scale_[i]);
            value += times(later_[k], times(along, along));
        }
        return value;
    }

    // Gauss with row exchanges, in place.
    bool solve() {
        for (std::size_t k = 0; k < border_; k++) {
            std::size_t pivot = k;
            for (std::size_t i = k + 1; i < border_; i++)
                if (std::norm(matrix_[i * border_ + k]) > std::norm(matrix_[pivot * border_ + k])) pivot = i;
            if (!(std::norm(matrix_[pivot * border_ + k]) > 0)) return false;
            if (pivot != k) {
                for (std::size_t j = k; j < border_; j++) std::swap(matrix_[k * border_ + j], matrix_[pivot * border_ + j]);
                std::swap(solution_[k], solution_[pivot]);
            }
            const Complex inverse = over(1.0, matrix_[k * border_ + k]);
            for (std::size_t i = k + 1; i < border_; i++) {
                const Complex factor = times(matrix_[i * border_ + k], inverse);
                for (std::size_t j = k + 1; j < border_; j++) matrix_[i * border_ + j] -= times(factor, matrix_[k * border_ + j]);
                solution_[i] -= times(factor, solution_[k]);
            }
        }
        for (std::size_t i = border_; i-- > 0;) {
            for (std::size_t j = i + 1; j < border_; j++) solution_[i] -= times(matrix_[i * border_ + j], solution_[j]);
            solution_[i] = over(solution_[i], matrix_[i * border_ + i]);
        }
        return true;
    }
};

}  // namespace gainroom
