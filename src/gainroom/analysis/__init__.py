"""Stability, margins, limits and gain regions of a loop, certified.

Margins        margins (of one joint, and the entry for all), boundary (of several joints, from samples in the core), margin_record
               (the record of all), disk_margin, _disk_modes and _mu (factors on all loops at once); multirate (kd on a path of its
               own), with lifted (its system) and peak_gain (over the unit circle); margins_outside (without bands of frequencies)
Delay margin   of one joint in margins; of coupled loops in boundary
Links          links (of any loop): dynamic_stiffness, with the damping of vibrations, from link_compliance
Gain limits    gain_limit, by proof or from samples; proved: proved_limit, by modal_loop, low_frequency_proof, followed_root and
               gain_directions; of one direction's gains: boundary
Stability      stability (roots, of the characteristic matrix), stability_boundary (the values of s or z along it)
Modes          equal_modes (of limbs that vibrate at the same limit), uncoupled_groups (of joints)
Frequencies    crossings (of one joint, certified between points), callable_scan (of a loop that is given as a callable)
Gain regions   gain_region of one joint, from gain_plane and excluded_region; of a part of coupled gains: part_region, and what else limits
               it: part_region_margins, part_region_other_loops, part_region_common_phase; of all states: part_region_every_state
Ranges         range_proof and box_loops: every joint whose parameters lie in ranges
In the core    core_loop (a coupled loop with its gains), loop_samples (of its frequency response; margins from them are not certified,
               and take milliseconds)
"""
