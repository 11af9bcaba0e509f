/* A force-sensing linear strip as a palm: what its readings mean, and the packets that tell of them.
 *
 * Plain C99 without a board: palmd's own tests compile it on the host. The protocol is that of
 * src/palmd/devices/strip.py; every board that has 12-bit inputs and a serial port to the host will do.
 */
#ifndef PALMD_STRIP_H
#define PALMD_STRIP_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum {
    STRIP_PACKET_BYTES = 12,
    STRIP_VERSION = 1,
    STRIP_POSITION_MAX = 16383,
    STRIP_FORCE_MAX = 4095,
    STRIP_ADC_MAX = 4095,
    STRIP_POSITION_READS = 4, /* added up: 14 bits of position from 12 of the input */
    STRIP_TOUCHED_US = 10000,
    STRIP_UNTOUCHED_US = 50000,
    STRIP_ON = 24, /* counts of force from which on it is touched, and below which it is let go */
    STRIP_OFF = 16
};

/* What the inputs read, 0 to STRIP_ADC_MAX. */
struct strip_readings {
    uint16_t position_sum; /* of STRIP_POSITION_READS readings of the sense line between both ends driven */
    uint16_t drive;        /* far end of the driven line while the sense line is loaded: v1 */
    uint16_t sense;        /* the loaded sense line: v2 */
};

struct strip {
    uint32_t sampled_us; /* when the next sample is due */
    uint32_t said_us;    /* when a packet was made last */
    uint8_t sequence;
    bool touched;
    bool begun;
};

/* Whether a sample is due at a time that may wrap. */
bool strip_due(const struct strip *strip, uint32_t now_us);

/* Takes a sample that was finished at sampled_us; writes the packet to send at now_us, if any, and returns its length,
 * STRIP_PACKET_BYTES or 0. Touched: each sample. Untouched: once at the lift-off, then every STRIP_UNTOUCHED_US. */
uint8_t strip_take(struct strip *strip, struct strip_readings readings, uint32_t sampled_us, uint32_t now_us,
                   uint8_t out[STRIP_PACKET_BYTES]);

/* Counts of force from both voltages: proportional to the contact's conductance, and so roughly to its force. */
uint16_t strip_force(uint16_t drive, uint16_t sense);

/* CRC-16 (CCITT: polynomial 0x1021, begun at 0xFFFF, not reflected). */
uint16_t strip_crc(const uint8_t *bytes, uint8_t count);

#ifdef __cplusplus
}
#endif
#endif
