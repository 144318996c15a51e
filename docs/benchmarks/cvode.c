/* CVODE around a right-hand side and a Jacobian in machine code, with no Python between them. */

#include "sundials.h"

typedef struct {
    kernel rhs, jacobian;
    const double *for_rhs, *for_jacobian;
    double *rows;
    int64_t size, calls, jacobians;
} law;
typedef int (*right_side)(double, void *, void *, void *);
typedef int (*derivative)(double, void *, void *, void *, void *, void *, void *, void *);

void *CVodeCreate(int, void *);
void CVodeFree(void **);
int CVodeInit(void *, right_side, double, void *);
int CVodeSStolerances(void *, double, double);
int CVodeSetUserData(void *, void *);
int CVodeSetLinearSolver(void *, void *, void *);
int CVodeSetJacFn(void *, derivative);
int CVodeSetMaxNumSteps(void *, long);
int CVodeSetStopTime(void *, double);
int CVodeGetNumSteps(void *, long *);
int CVode(void *, double, void *, double *, int);

enum { BDF = 2, NORMAL = 1 };

static int rhs(double t, void *y, void *slope, void *data) {
    law *l = data;
    l->calls++;
    return l->rhs(t, N_VGetArrayPointer(y), l->for_rhs, N_VGetArrayPointer(slope));
}

static int jacobian(double t, void *y, void *slope, void *matrix, void *data, void *a, void *b, void *c) {
    law *l = data;
    double *columns = SUNDenseMatrix_Data(matrix);
    int64_t n = l->size;
    int32_t singular = l->jacobian(t, N_VGetArrayPointer(y), l->for_jacobian, l->rows);
    (void)slope, (void)a, (void)b, (void)c;
    l->jacobians++;
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j < n; j++) columns[j * n + i] = l->rows[i * n + j];
    return singular;
}

/* Run y from t = 0 to `end`; return CVODE's flag, negative for a failure, and the number of steps. */
int run(law *l, double *y, double end, double rtol, double atol, long *steps) {
    void *context, *state, *matrix, *solver, *cvode;
    double t;
    int flag;
    l->calls = l->jacobians = 0;
    SUNContext_Create(0, &context);
    state = N_VMake_Serial((int)l->size, y, context);
    matrix = SUNDenseMatrix((int)l->size, (int)l->size, context);
    solver = SUNLinSol_Dense(state, matrix, context);
    cvode = CVodeCreate(BDF, context);
    CVodeInit(cvode, rhs, 0.0, state);
    CVodeSStolerances(cvode, rtol, atol);
    CVodeSetUserData(cvode, l);
    CVodeSetLinearSolver(cvode, solver, matrix);
    CVodeSetJacFn(cvode, jacobian);
    CVodeSetMaxNumSteps(cvode, 10000000);
    CVodeSetStopTime(cvode, end);
    flag = CVode(cvode, end, state, &t, NORMAL);
    CVodeGetNumSteps(cvode, steps);
    CVodeFree(&cvode);
    SUNLinSolFree(solver);
    SUNMatDestroy(matrix);
    N_VDestroy(state);
    SUNContext_Free(&context);
    return flag;
}
