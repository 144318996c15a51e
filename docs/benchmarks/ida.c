/* IDA around a residual and its Jacobian in machine code, with no Python between them. */
#include <string.h>

#include "sundials.h"

typedef struct {
    kernel residual, jacobian;
    const double *for_residual, *for_jacobian;
    double *given, *rows; /* [y, y', c], and the Jacobian by rows */
    int64_t size, calls, jacobians;
} law;
typedef int (*residual_function)(double, void *, void *, void *, void *);
typedef int (*derivative)(double, double, void *, void *, void *, void *, void *, void *, void *, void *);

void *IDACreate(void *);
void IDAFree(void **);
int IDAInit(void *, residual_function, double, void *, void *);
int IDASVtolerances(void *, double, void *);
int IDASetUserData(void *, void *);
int IDASetId(void *, void *);
int IDASetSuppressAlg(void *, int);
int IDASetLinearSolver(void *, void *, void *);
int IDASetJacFn(void *, derivative);
int IDASetMaxNumSteps(void *, long);
int IDASetStopTime(void *, double);
int IDAGetNumSteps(void *, long *);
int IDASolve(void *, double, double *, void *, void *, int);

enum { NORMAL = 1 };

static void gather(law *l, void *y, void *slope, double c) {
    size_t bytes = (size_t)l->size * sizeof(double);
    memcpy(l->given, N_VGetArrayPointer(y), bytes);
    memcpy(l->given + l->size, N_VGetArrayPointer(slope), bytes);
    l->given[2 * l->size] = c;
}

static int residual(double t, void *y, void *slope, void *out, void *data) {
    law *l = data;
    l->calls++;
    gather(l, y, slope, 0.0);
    return l->residual(t, l->given, l->for_residual, N_VGetArrayPointer(out));
}

static int jacobian(double t, double c, void *y, void *slope, void *r, void *matrix, void *data, void *a, void *b,
                    void *d) {
    law *l = data;
    double *columns = SUNDenseMatrix_Data(matrix);
    int64_t n = l->size;
    (void)r, (void)a, (void)b, (void)d;
    l->jacobians++;
    gather(l, y, slope, c);
    int32_t failed = l->jacobian(t, l->given, l->for_jacobian, l->rows);
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j < n; j++) columns[j * n + i] = l->rows[i * n + j];
    return failed;
}

/* Run y and its slope from t = 0 to `end`, `differential` telling the unknowns that have a derivative and `atol`
 * what each may be wrong by; return IDA's flag, negative for a failure, and the number of steps. */
int run(law *l, double *y, double *slope, double *differential, double *atol, double end, double rtol, long *steps) {
    void *context, *state, *rate, *kind, *absolute, *matrix, *solver, *ida;
    double t;
    int flag, n = (int)l->size;
    l->calls = l->jacobians = 0;
    SUNContext_Create(0, &context);
    state = N_VMake_Serial(n, y, context);
    rate = N_VMake_Serial(n, slope, context);
    kind = N_VMake_Serial(n, differential, context);
    absolute = N_VMake_Serial(n, atol, context);
    matrix = SUNDenseMatrix(n, n, context);
    solver = SUNLinSol_Dense(state, matrix, context);
    ida = IDACreate(context);
    IDAInit(ida, residual, 0.0, state, rate);
    IDASVtolerances(ida, rtol, absolute);
    IDASetUserData(ida, l);
    IDASetId(ida, kind);
    IDASetSuppressAlg(ida, 1);
    IDASetLinearSolver(ida, solver, matrix);
    IDASetJacFn(ida, jacobian);
    IDASetMaxNumSteps(ida, 1000000);
    IDASetStopTime(ida, end);
    flag = IDASolve(ida, end, &t, state, rate, NORMAL);
    IDAGetNumSteps(ida, steps);
    IDAFree(&ida);
    SUNLinSolFree(solver);
    SUNMatDestroy(matrix);
    N_VDestroy(state);
    N_VDestroy(rate);
    N_VDestroy(kind);
    N_VDestroy(absolute);
    SUNContext_Free(&context);
    return flag;
}
