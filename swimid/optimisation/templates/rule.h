/* Stiffness rule of the robot {{ rule.robot }}: {{ rule.coefficient }} in {{ rule.unit }}.
 * Objective: {{ rule.objective }}.
 * Frequency {{ "%g to %g" | format(*rule.frequency_hz) }} Hz, amplitude {{ "%g to %g" | format(*rule.amplitude_deg) }} deg; held at its ends outside. */
#ifndef SWIMID_STIFFNESS_RULE_H
#define SWIMID_STIFFNESS_RULE_H

#define SWIMID_RULE_CURVES {{ rule.curves | length }}

static const float swimid_rule_amplitude_deg[SWIMID_RULE_CURVES] = { {{- rule.curves | map(attribute="amplitude_deg") | map("single") | join(", ") -}} };

/* {{ rule.coefficient }} = c0 + c1 f + c2 f^2 at each amplitude */
static const float swimid_rule_coefficients[SWIMID_RULE_CURVES][3] = {
{% for c in rule.curves %}
    { {{- c.coefficients | map("single") | join(", ") -}} },
{% endfor %}
};

static float swimid_rule_within(float value, float low, float high)
{
    return value < low ? low : (value > high ? high : value);
}

static float swimid_rule_curve(int k, float f)
{
    const float *c = swimid_rule_coefficients[k];
    return swimid_rule_within(c[0] + f * (c[1] + f * c[2]), {{ rule.between | map("single") | join(", ") }});
}

/* {{ rule.coefficient }} ({{ rule.unit }}) at a frequency (Hz) and an amplitude (deg) */
static float swimid_stiffness_for(float frequency_hz, float amplitude_deg)
{
    const float f = swimid_rule_within(frequency_hz, {{ rule.frequency_hz | map("single") | join(", ") }});
    const float a = swimid_rule_within(amplitude_deg, {{ rule.amplitude_deg | map("single") | join(", ") }});
    int k = 0;
    float share;
    if (SWIMID_RULE_CURVES == 1)
        return swimid_rule_curve(0, f);
    while (k < SWIMID_RULE_CURVES - 2 && a > swimid_rule_amplitude_deg[k + 1])
        k++;
    share = (a - swimid_rule_amplitude_deg[k])
        / (swimid_rule_amplitude_deg[k + 1] - swimid_rule_amplitude_deg[k]);
    return (1.0f - share) * swimid_rule_curve(k, f) + share * swimid_rule_curve(k + 1, f);
}

#endif
