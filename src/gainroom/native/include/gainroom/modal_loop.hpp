// n coupled joints under gains on the diagonal, by their modes: L = P diag(c), and how far its parts bend between two frequencies.
//
// With x = ω² (sampled: x = |z − 1|²/T_s²), which takes the two integrators of a free mechanism away,
//
//   x P = M₀ f₀ + Σ_k φ_k φ_kᵀ f_k,   d_i = x/c_i,
//
// where every f is a scalar function of ω: f₀ belongs to the rigid motion, f_k to a mode (real φ: two poles) or to one pole (complex φ). Sampled functions stand behind the hold, the current loop and the part of the delay that is no whole tick; whole ticks and
// the controller are in c_i. For each of them a bound of its second derivative over an interval is known, by the pole's distance:
// nothing between two samples is guessed.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "factors.hpp"

namespace gainroom {

// Bounds of |u|, |u'| and |u''| by ω over an interval.
struct Bend {
    double value, first, second;
};

// An interval of ω, and the variable in which functions are interpolated over it: x, or ω where x stops to rise.
struct Cell {
    double a, b, step, inexact;
    bool in_x;
    Complex start, end;  // z at a and b

    Cell(double a, double b, double step, double inexact)
        : a(a), b(b), step(step), inexact(inexact),
          in_x(step == 0 || b * step <= kPi / 2), start(std::polar(1.0, a * step)), end(std::polar(1.0, b * step)),
          largest_(weight(b, step)) {
        const double way = in_x ? largest_ - weight(a, step) : b - a, width = way * way / 8;
        if (in_x) {  // (x u)_xx = 3u'/4ω + u''/4, sampled likewise
            const double half = step == 0 ? 1.0 : std::cos(0.5 * b * step), rise = step == 0 ? 2 * a : 2 * std::sin(a * step) / step;
            value_ = inexact * largest_;
            first_ = width * (step == 0 ? 0.75 / a : step / std::sin(a * step));
            second_ = 0.25 * width / (half * half);
            plain_second_ = width / (rise * rise);
            plain_first_ = plain_second_ * (step == 0 ? 1 / a : step / std::tan(a * step));
        } else {
            const double rise = 2 / step * (a * step < kPi / 2 ? 1.0 : std::sin(a * step));
            value_ = 2 * width + inexact * largest_;
            first_ = 2 * rise * width;
            second_ = largest_ * width;
            plain_first_ = 0.0;
            plain_second_ = width;
        }
    }

    static double weight(double omega, double step) {
        if (step == 0) return omega * omega;
        const double root = 2 * std::sin(0.5 * omega * step) / step;
        return root * root;
    }
    // Largest deviation of x u from its interpolation between the ends, with what u itself is off by.
    double weighted(const Bend& u) const { return value_ * u.value + first_ * u.first + second_ * u.second; }
    // The same of f itself.
    double plain(double first, double second) const { return plain_first_ * first + plain_second_ * second; }

   private:
    double largest_, value_, first_, second_, plain_first_, plain_second_;
};

// Least distance of z on the boundary between the ends of a cell from `z`, at `angle`.
inline double distance(const Cell& cell, Complex z, double angle) {
    const double least = std::min(size_of(z - cell.start), size_of(z - cell.end));
    return cell.a * cell.step <= angle && angle <= cell.b * cell.step ? std::min(least, std::fabs(size_of(z) - 1)) : least;
}

// The same of v from `place`.
inline double distance(const Cell& cell, Complex place) {
    if (cell.step == 0) return size_of({place.real(), std::clamp(place.imag(), cell.a, cell.b) - place.imag()});
    const Complex z(1 + cell.step * place.real(), cell.step * place.imag());
    return distance(cell, z, std::atan2(z.imag(), z.real())) / cell.step;
}

class ModalLoop {
   public:
    std::size_t size, modes;
    std::vector<double> rigid;        // M₀ (n, n)
    std::vector<double> skew;         // its imaginary part, where `twofold`; else empty
    bool twofold = false;             // F of a loop that is not symmetric, see exclusion.hpp: n = 2 r, r laws, and these again
    std::vector<Complex> shapes;      // φ (modes, n), real where there are partners
    std::vector<Complex> poles;       // λ (modes), in s
    std::vector<Complex> partners;    // the other pole of each mode, μ; none: poles stand alone
    double bandwidth, damping_ratio;  // of the current loop that all joints share, sampled only; 0: ideal
    double fraction, step;            // of a tick by which the torque comes later; T_s, 0: continuous
    double inexact;                   // relative: how far the sum over modes is off
    std::vector<Factors> laws;        // c (n), continuous: with current loop
    std::vector<double> delays;       // of the laws (n)
    std::vector<std::size_t> alike;   // of each joint: the first that has the same law and delay; see find_alike

    // To be called once, when everything above is filled in.
    void prepare() {
        find_alike();
        held_.clear();
        current_.clear();
        if (step == 0) return;
        if (bandwidth > 0) {
            const Complex root = std::sqrt(Complex(damping_ratio * damping_ratio - 1, 0.0));
            fast_[0] = bandwidth * (-damping_ratio + root);
            fast_[1] = bandwidth * (-damping_ratio - root);
            current_ = {held(fast_[0]), held(fast_[1])};
        }
        for (const auto* part : {&poles, &partners})
            for (const Complex pole : *part) {
                held_.push_back(held(pole));
                weights(pole, held_.back());
            }
    }

    // Again where laws have been changed since `prepare`: equal ones are evaluated once.
    void find_alike() {
        alike.clear();
        for (std::size_t i = 0; i < laws.size(); i++) {
            std::size_t k = 0;
            while (k < i && !(delays[k] == delays[i] && laws[k].gain == laws[i].gain && laws[k].zeros == laws[i].zeros && laws[k].poles == laws[i].poles))
                k++;
            alike.push_back(k);
        }
    }

    bool pairs() const { return !partners.empty(); }

    Complex rigid_at(std::size_t k) const { return {rigid[k], skew.empty() ? 0.0 : skew[k]}; }

    // f₀ and f_k (modes) at s = ω (tilt + j), |tilt| ≪ 1.
    void functions(double omega, Complex& f0, Complex* f, double tilt = 0.0) const {
        const double x = Cell::weight(omega, step);
        if (step == 0) {
            f0 = -1.0;
            for (std::size_t k = 0; k < modes; k++) {
                const Complex s(omega * tilt, omega), away = s - poles[k];
                f[k] = x * over(1.0, pairs() ? times(away, s - partners[k]) : away);
            }
            return;
        }
        const Complex z = std::polar(std::exp(omega * tilt * step), omega * step);
        Complex fast[2] = {0.0, 0.0};
        for (std::size_t q = 0; q < current_.size(); q++) fast[q] = current_[q].at(z);
        for (std::size_t k = 0; k < modes; k++) {
            const Complex one = behind(held_[k], z, fast);
            f[k] = x * (pairs() ? over(one - behind(held_[modes + k], z, fast), poles[k] - partners[k]) : one);
        }
        const Rigid r = rigid_parts();
        f0 = -(r.constant + over(r.once, z) + over(r.twice, times(z, z)));
        for (std::size_t q = 0; q < current_.size(); q++) f0 += x * times(slow(q), fast[q]);
    }

    // Largest deviations of f₀ and f_k from their interpolations over a cell.
    void bends(const Cell& cell, double& f0, double* f) const {
        if (step == 0) {
            f0 = 0.0;
            for (std::size_t k = 0; k < modes; k++) {
                const double near = 1 / distance(cell, poles[k]);
                if (!pairs()) {
                    f[k] = cell.weighted({near, near * near, 2 * near * near * near});
                    continue;
                }
                const double h = near / distance(cell, partners[k]), turn = 2 * cell.b + size_of(poles[k] + partners[k]);
                f[k] = cell.weighted({h, h * h * turn, 2 * h * h * (h * turn * turn + 1)});
            }
            return;
        }
        Bend fast[2] = {{0, 0, 0}, {0, 0, 0}};
        for (std::size_t q = 0; q < current_.size(); q++) fast[q] = bend(current_[q], cell);
        for (std::size_t k = 0; k < modes; k++) {
            const Bend one = behind(held_[k], cell, fast);
            if (!pairs()) {
                f[k] = cell.weighted(one);
            } else {
                const Bend two = behind(held_[modes + k], cell, fast);
                const double apart = size_of(poles[k] - partners[k]);
                f[k] = cell.weighted({(one.value + two.value) / apart, (one.first + two.first) / apart, (one.second + two.second) / apart});
            }
        }
        const Rigid r = rigid_parts();
        f0 = cell.plain(step * (std::fabs(r.once) + 2 * std::fabs(r.twice)), step * step * (std::fabs(r.once) + 4 * std::fabs(r.twice)));
        for (std::size_t q = 0; q < current_.size(); q++) {
            const double size = size_of(slow(q));
            f0 += cell.weighted({size * fast[q].value, size * fast[q].first, size * fast[q].second});
        }
    }

    // An ω, and what laws have in common there: x, v, and e^{−jωT} of the last delay.
    struct Place {
        double omega, x;
        Complex v;
        double delay = 0.0;
        Complex late = 1.0;
    };
    Place place(double omega) const { return {omega, Cell::weight(omega, step), variable({0.0, omega}, step)}; }

    // d_i = x/c_i at ω.
    Complex inverse_law(std::size_t i, Place& at) const {
        Complex value = rational_at(laws[i], at.v);
        if (delays[i] > 0) {
            if (delays[i] != at.delay) at.late = late_by(at.delay = delays[i], {0.0, at.omega});
            value = times(value, at.late);
        }
        return over(at.x, value);
    }
    Complex inverse_law(std::size_t i, double omega) const {
        Place at = place(omega);
        return inverse_law(i, at);
    }

    // All d_i (n) at ω.
    void inverse_laws(double omega, Complex* d) const {
        Place at = place(omega);
        for (std::size_t i = 0; i < size; i++) d[i] = alike[i] < i ? d[alike[i]] : inverse_law(i, at);
    }

    // Of all joints (n), from |1/c_i| at the ends of the cell.
    void inverse_law_bends(const Cell& cell, const double* left, const double* right, double* out) const {
        for (std::size_t i = 0; i < size; i++) out[i] = alike[i] < i ? out[alike[i]] : inverse_law_bend(i, cell, std::max(left[i], right[i]));
    }

    // Largest deviation of d_i from its interpolation over a cell.
    double inverse_law_bend(std::size_t i, const Cell& cell, double at_ends) const {
        double growth, turn;
        rates(i, cell, growth, turn);
        const double value = at_ends * std::exp(0.5 * growth * (cell.b - cell.a)), first = growth + delays[i];
        return cell.weighted({value, value * first, value * (first * first + turn)});
    }

    // Least |d_i| over a cell, from |1/c_i| at the end where that is smaller.
    double least_inverse_law(std::size_t i, const Cell& cell, double at_ends) const {
        double growth, turn;
        rates(i, cell, growth, turn);
        return Cell::weight(cell.a, step) * at_ends * std::exp(-0.5 * growth * (cell.b - cell.a));
    }

    // |1/c_i| from d_i.
    static double inverse_law_size(Complex d, double omega, double step) { return size_of(d) / Cell::weight(omega, step); }

   private:
    // 1/(s − p) behind a hold, torque a fraction of a tick late: (now + before/z)/(z − E), by what the torque of now and that of the tick
    // before add. In partial fractions the two would grow as 1/E and cancel, or be infinite, where p decays within a small part of a tick.
    struct Held {
        Complex now, before, moved;  // E = e^{p T_s}
        double angle;                // of E
        Complex own, others[2];      // weights of C/(s − p) = w_p/(s − p) + Σ_q w_q/(s − q)
        Complex at(Complex z) const { return over(now + over(before, z), z - moved); }
    };
    // Of f₀ without the current loop's poles: −(constant + once/z + twice/z²).
    struct Rigid {
        double constant, once, twice;
    };

    std::vector<Held> held_, current_;
    Complex fast_[2];

    Held held(Complex pole) const {
        const Complex early = std::exp(pole * ((1 - fraction) * step)), moved = std::exp(pole * step);
        return {over(early - 1.0, pole), over(moved - early, pole), moved, std::arg(moved), 1.0, {0.0, 0.0}};
    }

    Bend bend(const Held& of, const Cell& cell) const {
        const double near = 1 / distance(cell, of.moved, of.angle), before = size_of(of.before), both = size_of(of.now) + before;
        return {both * near, step * near * (before + both * near), step * step * near * (before + near * (2 * before + both * (1 + 2 * near)))};
    }

    void weights(Complex pole, Held& of) const {
        if (current_.empty()) return;
        const double square = bandwidth * bandwidth;
        of.own = over(square, times(pole - fast_[0], pole - fast_[1]));
        of.others[0] = over(square, times(fast_[0] - fast_[1], fast_[0] - pole));
        of.others[1] = over(square, times(fast_[1] - fast_[0], fast_[1] - pole));
    }

    static Complex behind(const Held& of, Complex z, const Complex* fast) {
        return times(of.own, of.at(z)) + times(of.others[0], fast[0]) + times(of.others[1], fast[1]);
    }

    Bend behind(const Held& of, const Cell& cell, const Bend* fast) const {
        const Bend u = bend(of, cell);
        const double w = size_of(of.own), v0 = size_of(of.others[0]), v1 = size_of(of.others[1]);
        return {w * u.value + v0 * fast[0].value + v1 * fast[1].value, w * u.first + v0 * fast[0].first + v1 * fast[1].first,
                w * u.second + v0 * fast[0].second + v1 * fast[1].second};
    }

    // Bounds of how fast log |1/c_i| grows over a cell, and of its second derivative; the delay, which only turns, left out.
    void rates(std::size_t i, const Cell& cell, double& growth, double& turn) const {
        growth = turn = 0.0;
        for (const auto* roots : {&laws[i].zeros, &laws[i].poles})
            for (const Complex root : *roots) {
                const double near = 1 / distance(cell, root);
                growth += near;
                turn += near * (near + step);
            }
    }

    // x times what C/s² = 1/s² − (2ζ/ω_c)/s + … leaves of integrators behind hold and fraction.
    Rigid rigid_parts() const {
        const double early = 1 - fraction, alpha = 0.5 * early * early, beta = 0.5 - alpha;
        const double lag = current_.empty() ? 0.0 : 2 * damping_ratio / bandwidth / step;
        return {alpha - lag * early, beta - alpha + early - lag * (fraction - early), fraction - beta + lag * fraction};
    }

    // Weight of 1/(s − q) in C/s².
    Complex slow(std::size_t q) const {
        return over(bandwidth * bandwidth, times(fast_[q] - fast_[1 - q], times(fast_[q], fast_[q])));
    }
};

}  // namespace gainroom
