#include "strip.h"

enum { TOUCHED = 0x01, SATURATED = 0x02, FORCE_GAIN = 256 };

bool strip_due(const struct strip *strip, uint32_t now_us)
{
    return !strip->begun || (int32_t)(now_us - strip->sampled_us) >= 0;
}

uint16_t strip_crc(const uint8_t *bytes, uint8_t count)
{
    uint16_t crc = 0xFFFF;
    while (count--) {
        crc ^= (uint16_t)(*bytes++ << 8);
        for (uint8_t bit = 0; bit < 8; bit++)
            crc = (uint16_t)(crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1);
    }
    return crc;
}

/* The contact connects the driven line (voltage v1) with the sense line, which the resistor R0 pulls down to v2: its
 * conductance is v2/(v1 - v2)/R0. */
uint16_t strip_force(uint16_t drive, uint16_t sense)
{
    if (sense == 0)
        return 0;
    if (drive <= sense)
        return STRIP_FORCE_MAX;
    uint32_t force = (uint32_t)sense * FORCE_GAIN / (uint32_t)(drive - sense);
    return force < STRIP_FORCE_MAX ? (uint16_t)force : STRIP_FORCE_MAX;
}

static void put(uint8_t *out, uint16_t value)
{
    out[0] = (uint8_t)(value & 0xFF);
    out[1] = (uint8_t)(value >> 8);
}

uint8_t strip_take(struct strip *strip, struct strip_readings readings, uint32_t sampled_us, uint32_t now_us,
                   uint8_t out[STRIP_PACKET_BYTES])
{
    uint16_t force = strip_force(readings.drive, readings.sense);
    bool was_touched = strip->touched, first = !strip->begun;

    strip->touched = force >= (was_touched ? STRIP_OFF : STRIP_ON);
    /* On a fixed grid; missed samples are skipped. */
    strip->sampled_us = first ? sampled_us + STRIP_TOUCHED_US : strip->sampled_us + STRIP_TOUCHED_US;
    if ((int32_t)(now_us - strip->sampled_us) >= 0)
        strip->sampled_us = now_us + STRIP_TOUCHED_US;
    strip->begun = true;

    bool silent_for_long = first || now_us - strip->said_us >= STRIP_UNTOUCHED_US;
    if (!strip->touched && !was_touched && !silent_for_long)
        return 0;

    uint32_t age = (now_us - sampled_us) / 10;
    uint16_t position = readings.position_sum;
    out[0] = 0xA5;
    out[1] = 0x5A;
    out[2] = (uint8_t)(STRIP_VERSION << 4 | (strip->touched ? TOUCHED : 0) | (force >= STRIP_FORCE_MAX ? SATURATED : 0));
    out[3] = strip->sequence++;
    put(out + 4, strip->touched ? (position < STRIP_POSITION_MAX ? position : STRIP_POSITION_MAX) : 0);
    put(out + 6, strip->touched ? force : 0);
    put(out + 8, age < 0xFFFF ? (uint16_t)age : 0xFFFF);
    put(out + 10, strip_crc(out + 2, 8));
    strip->said_us = now_us;
    return STRIP_PACKET_BYTES;
}
