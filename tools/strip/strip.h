/* Force-sensing linear strip: conversion of its readings, and encoding of packets.
 *
 * Plain C99, independent of the board; palmd's tests compile it on the host. The protocol is documented in
 * src/palmd/devices/strip.py. It works on every board with 12-bit inputs and a serial port to the host.
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
    STRIP_POSITION_READS = 4, /* summed: 14 bits of position from 12-bit inputs */
    STRIP_TOUCHED_US = 10000,
    STRIP_UNTOUCHED_US = 50000,
    STRIP_ON = 24, /* force counts at which a touch begins */
    STRIP_OFF = 16 /* force counts below which it ends */
};

/* Readings of the inputs, 0 to STRIP_ADC_MAX. */
struct strip_readings {
    uint16_t position_sum; /* sum of STRIP_POSITION_READS readings of the sense line with both ends driven */
    uint16_t drive;        /* far end of the drive line while the sense line is loaded: v1 */
    uint16_t sense;        /* the loaded sense line: v2 */
};

struct strip {
    uint32_t sampled_us; /* when the next sample is due */
    uint32_t said_us;    /* time of the last packet */
    uint8_t sequence;
    bool touched;
    bool begun;
};

/* Whether a sample is due at now_us, which may wrap around. */
bool strip_due(const struct strip *strip, uint32_t now_us);

/* Process a sample that was finished at sampled_us: write the packet to send at now_us, if any, and return its length,
 * STRIP_PACKET_BYTES or 0. Touched: a packet for each sample. Untouched: one at the lift-off, then every
 * STRIP_UNTOUCHED_US. */
uint8_t strip_take(struct strip *strip, struct strip_readings readings, uint32_t sampled_us, uint32_t now_us,
                   uint8_t out[STRIP_PACKET_BYTES]);

/* Force counts from both voltages: proportional to the contact's conductance, and so approximately to its force. */
uint16_t strip_force(uint16_t drive, uint16_t sense);

/* CRC-16 (CCITT: polynomial 0x1021, initial value 0xFFFF, not reflected). */
uint16_t strip_crc(const uint8_t *bytes, uint8_t count);

#ifdef __cplusplus
}
#endif
#endif
